"""`rossec border`: a border router as a process."""

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.commands import Shell, refused
from tests.support.site import Site

ROSSEC = str(Path(sys.executable).parent / "rossec")


@contextlib.contextmanager
def started(environ: dict[str, str], *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [ROSSEC, "border", "--listen", "::1", "--port", "0", *options]
    with subprocess.Popen(
        command, env=environ, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def environ_of(site: Site) -> dict[str, str]:
    return {**os.environ, **site.environ}


async def test_it_runs_until_it_is_ended(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        home = site.enroll("/border")
        with started(environ_of(site), "--json") as process:
            assert process.stdout is not None
            ready = json.loads(await _line(process))
            assert ready["ready"][0] == "::1"
            assert ready["things"] == 0
            with started(environ_of(site)) as second:
                _, errors = await _ended(second)
                assert second.returncode == 1
                assert "/border runs already" in errors
            while not (home.path / "border.status").exists():
                assert process.poll() is None
                await asyncio.sleep(0.05)
            process.send_signal(signal.SIGTERM)
            _, errors = await _ended(process)
            assert (process.returncode, errors) == (0, "")
        assert not (home.path / "border.status").exists()


async def test_it_says_where_in_words(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/border")
        with started(environ_of(site)) as process:
            assert (await _line(process)).startswith("border router /border at ::1 port ")
            process.send_signal(signal.SIGINT)
            _, errors = await _ended(process)
            assert "add things: rossec border add NAME --key FILE" in errors


def test_without_an_identity_or_with_options_before_a_verb(empty: Shell) -> None:
    refused(empty("border"), "/border has no ca.pem", "rossec node request /border")
    refused(empty("border", "--port", "1", "list"), "before a verb", code=2)


def test_without_the_extra(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rossec.border.handshakes", None)
    refused(empty("border"), "CoAP for things is not installed", "rossec[constrained]")


async def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return await asyncio.to_thread(process.stdout.readline)


async def _ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    return await asyncio.to_thread(process.communicate, timeout=30)
