from pathlib import Path

import pytest

from ca.certificates import Identity
from rossec.cli.main import run
from tests.support.site import Site


async def test_a_node_in_order_and_its_faults(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import asyncio

    async with Site(tmp_path / "site").running() as site:
        environ = dict(site.environ)

        async def doctor(*words: str, **more: str) -> tuple[int, str]:
            code = await asyncio.to_thread(run, ["doctor", *words], {**environ, **more})
            return code, "".join(capsys.readouterr())

        code, said = await doctor("/robot", "--offline")
        assert code == 1
        assert "not ok  /robot has no ca.pem" in said
        site.enroll("/robot")
        code, said = await doctor("/robot")
        assert code == 1
        assert "not ok  no grants: it may do nothing" in said
        site.publish("/robot", "/x")
        code, said = await doctor("/robot", ROSSEC_ALLOW_PLAIN="/open")
        assert code == 0
        assert "ok      /robot of home until" in said
        assert "ok      may publish /x until" in said
        assert "has a fresh revocation list" in said
        assert "PLAIN   /open is neither encrypted nor checked" in said
        async with site.node("/other") as other:
            code, said = await doctor("/robot", ROS_MASTER_URI=other.uri)
            assert code == 1
            assert "not ok  /other answers there" in said
        home = site.enroll("/robot")
        home.install(site.authority.issue(home.request(), site.now(), 86400), site.now())
        assert isinstance(site.identity("/robot"), Identity)
        code, said = await doctor("/robot", ROS_MASTER_URI="http://127.0.0.1:1")
        assert code == 1
        assert "3 checks failed" in said


async def test_an_identity_that_ends_soon_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [0.0]
    import time

    clock[0] = time.time() - 3500
    site = Site(tmp_path / "site", clock=lambda: clock[0])
    site.enroll("/robot", lifetime=3700)
    (site.root / "rossec.toml").write_text('[rospy]\nallow_plain = ["/f"]\n')
    assert run(["doctor", "/robot", "--offline"], {"ROSSEC_HOME": str(site.root)}) == 1
    said = "".join(capsys.readouterr())
    assert "the identity ends soon" in said
    assert "PLAIN   /f" in said
