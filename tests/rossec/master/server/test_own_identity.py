"""The master's own identity: reloaded, renewed, or a warning logged in time."""

import time
from functools import partial
from pathlib import Path

import pytest

from ca.certificates import open_renewal
from ca.errors import CAError, CertificateExpired
from rossec.authority.renewals import renew
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master.rights.renewals import RenewalAnswer
from rossec.master.server.maintenance import OwnIdentity
from tests.support.site import DAY, HOUR, Site

MASTER = "/master"
LIFE = 30 * DAY
NOW = int(time.time())


class World:
    def __init__(self, root: Path) -> None:
        self.now = NOW
        self.site = Site(root / "site", clock=lambda: self.now)
        self.home = self.site.enroll(MASTER, LIFE)
        self.own = OwnIdentity(self.home, NOW)
        self.before = self.own.credentials.current.certificate

    def check(self, now: int) -> bool:
        """Whether the certificate has changed since the last call."""
        self.now = now
        self.own.check(now)
        shown, self.before = self.own.credentials.current.certificate != self.before, self.shown
        return shown

    @property
    def shown(self) -> bytes:
        return self.own.credentials.current.certificate


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


def test_another_certificate_is_reloaded_without_a_restart(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    assert not world.check(NOW + 25 * DAY)
    assert "the master's own identity: it expires " in caplog.text
    assert "(rossec ca renew /master, then rossec node install FILE here; no restart)" in caplog.text
    world.site.renew(MASTER, LIFE)
    caplog.clear()
    assert world.check(NOW + 25 * DAY + 10)
    assert world.shown == world.home.credentials().certificate
    assert not world.check(NOW + 40 * DAY)
    assert caplog.text == ""


def test_a_warning_is_logged_every_hour_and_not_every_round(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    for second in range(0, 2 * HOUR, 600):
        world.check(NOW + 25 * DAY + second)
    assert len(caplog.messages) == 2
    world.check(NOW + 31 * DAY)
    assert "it expired " in caplog.messages[-1]


def test_the_identity_is_renewed_with_an_intermediate(world: World) -> None:
    world.own.renew = partial(answered, world)
    assert not world.check(NOW + 19 * DAY)
    assert world.check(NOW + 21 * DAY)
    assert world.home.identity(world.now).not_after > NOW + 50 * DAY
    assert not world.check(NOW + 21 * DAY + 10)


def test_a_failed_renewal_is_tried_again(world: World, caplog: pytest.LogCaptureFixture) -> None:
    attempts = []

    def fails(request: bytes, now: int) -> RenewalAnswer:
        attempts.append(now)
        raise CAError("not today", "ask tomorrow")

    world.own.renew = fails
    for second in (0, 10, 599, 600):
        world.check(NOW + 25 * DAY + second)
    assert attempts == [NOW + 25 * DAY, NOW + 25 * DAY + 600]
    assert "not today (ask tomorrow)" in caplog.text
    world.own.renew = lambda *_: RenewalAnswer(b"garbage", "")
    world.check(NOW + 26 * DAY)
    assert world.shown == world.home.credentials().certificate


def answered(world: World, request: bytes, now: int) -> RenewalAnswer:
    return RenewalAnswer(renew(world.site.authority, request, now), "renewed")


def test_the_authority_answers_later(world: World, caplog: pytest.LogCaptureFixture) -> None:
    """One request, again and again; a warning only if the answer does not come."""
    asked = list[bytes]()

    def later(request: bytes, now: int) -> RenewalAnswer:
        asked.append(request)
        return RenewalAnswer(b"", "the key is locked")

    world.own.renew = later
    begin = NOW + 25 * DAY
    for second in range(0, 60, 10):
        world.check(begin + second)
    assert caplog.messages == []
    for second in range(60, HOUR, 10):
        world.check(begin + second)
    [line] = caplog.messages
    assert "after which no node connects: the key is locked (rossec ca renew /master" in line
    opened = {open_renewal(each, world.site.anchor, begin, lambda *_: None).csr for each in asked[:6]}
    assert len(opened) == 1, "the authority answers one request with one certificate"
    world.own.renew = partial(answered, world)
    assert world.check(begin + HOUR)


def test_one_that_has_ended_is_not_asked_for(world: World, caplog: pytest.LogCaptureFixture) -> None:
    world.own.renew = partial(answered, world)
    assert not world.check(NOW + 31 * DAY)
    assert "it expired " in caplog.text
    assert "rossec ca renew --expired /master, then rossec node install FILE here" in caplog.text


def test_another_key_needs_a_restart(world: World, caplog: pytest.LogCaptureFixture) -> None:
    there = world.home.path
    there.rename(there.with_name("away"))
    world.home.create_request(world.site.anchor.domain)
    world.home.install(world.site.authority.issue(world.home.request(), NOW, LIFE, replace_key=MASTER), NOW)
    assert not world.check(NOW + 10)
    assert caplog.messages == [
        "the master's own identity: the installed identity has another key (restart the master)"
    ]
    assert not world.check(NOW + 20)
    assert len(caplog.messages) == 1


def test_a_missing_or_damaged_file_changes_nothing(world: World, caplog: pytest.LogCaptureFixture) -> None:
    file = world.home.path / "node.pem"
    data = file.read_bytes()
    file.unlink()
    assert not world.check(NOW + 10)
    assert "No such file" in caplog.text
    file.write_bytes(b"garbage")
    assert not world.check(NOW + 20)
    file.write_bytes(data)
    assert not world.check(NOW + 30)


def test_without_a_valid_identity_there_is_no_master(world: World) -> None:
    with pytest.raises(CertificateExpired):
        OwnIdentity(world.home, NOW + LIFE + 10)
    with pytest.raises(ConfigurationError):
        OwnIdentity(NodeHome.of(world.site.root, "/other"), NOW)
