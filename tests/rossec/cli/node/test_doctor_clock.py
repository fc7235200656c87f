"""The doctor where the clock is of another year, or a certificate has really ended."""

import asyncio
import time
from pathlib import Path

import pytest

from rossec.cli.main import run
from tests.support.site import Site


@pytest.mark.parametrize(
    ("years", "identity", "which"),
    [
        (1, "by this host's clock, which says 20", "ahead of the master's"),
        (12, "everything of 'home' is over", "ahead of the master's"),
        (-1, "certificate becomes valid in", "behind the master's"),
    ],
)
async def test_a_clock_of_another_year_is_told_by_the_master(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    years: int,
    identity: str,
    which: str,
) -> None:
    """The certificates of everybody are out of their time: it is the clock, nothing to renew."""
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/robot")
        wrong = int(time.time()) + years * 365 * 86400
        monkeypatch.setattr("rossec.cli.node.doctor.now", lambda: wrong)
        monkeypatch.setattr("rossec.cli.shared.context.now", lambda: wrong)

        def shifted() -> float:
            return time.time() + years * 365 * 86400

        monkeypatch.setattr("rossec.clock.time", shifted)
        monkeypatch.setattr("rossec.net.context.time", shifted, raising=False)
        code = await asyncio.to_thread(run, ["doctor", "/robot"], dict(site.environ))
        said = "".join(capsys.readouterr())
        assert code == 1
        assert identity in said
        assert which in said, said
        assert "synchronize the clocks of both hosts" in said


async def test_a_master_that_has_really_ended_is_said_to_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The clocks agree: then a certificate that is over is over."""
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/robot", lifetime=86400)
        assert site.master is not None
        site.renew("/master", lifetime=1)
        own = site.enroll("/master").credentials()
        site.master.context.credentials.current = own  # type: ignore[misc]
        await asyncio.sleep(2.1)
        code = await asyncio.to_thread(run, ["doctor", "/robot"], dict(site.environ))
        said = "".join(capsys.readouterr())
        assert code == 1
        assert "ok      the clock agrees with the master's" in said
        assert "not ok  the certificate of /master expired" in said
        assert "rossec ca renew --expired /master" in said
