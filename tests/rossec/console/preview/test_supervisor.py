import asyncio
import os
import time
from pathlib import Path

import pytest

from rossec.console.preview import NAME
from rossec.console.server.supervisor import PreviewProcess, check_enrolled
from rossec.console.server.web import PreviewClient
from rossec.errors import ConfigurationError
from tests.rossec.console.preview.test_receiver import POSE, drive, until_recorded
from tests.support.consoleprocess import ask, running_web
from tests.support.site import Site


def test_a_console_that_is_not_enrolled_has_no_preview(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="receives as the node /console") as error:
        check_enrolled(tmp_path)
    assert "rossec node request /console" in error.value.hint


async def test_an_enrolled_one_has(site: Site) -> None:
    site.enroll(NAME)
    check_enrolled(site.root)


@pytest.mark.timeout(120)
async def test_a_process_receives_for_the_pages_and_ends_with_them(site: Site) -> None:
    site.enroll(NAME)
    site.publish("/robot", "/pose")
    site.subscribe(NAME, "/pose")
    process = PreviewProcess({**os.environ, **site.environ})
    client = PreviewClient(process.start())
    client.start()
    pid = process.pid
    assert pid is not None
    async with site.node("/robot") as robot:
        driving = asyncio.ensure_future(drive(await robot.publisher("/pose", POSE)))
        await until_recorded(client, "/pose", 3)
        driving.cancel()
    await client.close()
    begin = time.monotonic()
    await process.end()
    assert time.monotonic() - begin < 5, "it ended by itself"
    assert process.pid is None
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    await process.end()


@pytest.mark.timeout(120)
async def test_pages_show_what_was_received(site: Site, tmp_path: Path) -> None:
    """A robot, the node of the preview and the confined web process, as they really run."""
    site.enroll(NAME)
    site.publish("/robot", "/robot/pose")
    site.subscribe(NAME, "/robot/pose")
    preview = PreviewProcess({**os.environ, **site.environ})
    async with site.node("/robot") as robot, running_web(tmp_path, preview=preview) as running:
        form = {"Origin": running.origin, "Content_Type": "application/x-www-form-urlencoded"}
        code = f"code={running.home.add_code()}"
        answer = await ask(running, "/login", "POST", code, **form)
        cookie = answer.headers["set-cookie"].partition(";")[0]
        before = await ask(running, "/see/robot/pose", Cookie=cookie)
        assert "Made up." in before.body
        driving = asyncio.ensure_future(drive(await robot.publisher("/robot/pose", POSE)))
        async with asyncio.timeout(60):
            while "Made up." in (await ask(running, "/see/robot/pose", Cookie=cookie)).body:  # noqa: ASYNC110
                await asyncio.sleep(0.2)
        page = await ask(running, "/see/robot/pose", Cookie=cookie)
        assert page.status == 200
        assert "kept in memory only" in page.body
        driving.cancel()
        pid = preview.pid
        assert pid is not None
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


async def test_a_process_that_does_not_start_is_reaped() -> None:
    process = PreviewProcess({}, module="rossec.not_there")
    pages = process.start()
    await process.end()
    pages.close()
    assert process.pid is None
