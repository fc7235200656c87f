"""Which things a border router serves: stated for it, in time, and known not to be revoked."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from ca.revocation.lists import MAX_AGE, Timestamp, digest, open_list
from ca.revocation.trust_status import Revocations
from ca.things import ThingKey, ThingSecret, ThingStatement, sign_statement
from rossec.border.bridge import Roster
from rossec.saved_statements import ThingFiles
from tests.support.pki import new_signer
from tests.support.site import Site
from tests.support.things import again

LAMP = "/things/lamp"
KID = b"\x2b"


class Place:
    """A border router's directory, its authority, and a clock."""

    def __init__(self, root: Path) -> None:
        self.site = Site(root)
        self.home = self.site.enroll("/border")
        self.files = ThingFiles(self.home)
        self.now = self.site.now() + 100  # what is written now is old
        self.revocations = Revocations(self.site.anchor.public_key)
        self.confirm()
        self.roster = Roster(self.files, self.revocations, lambda: self.now)
        self.lamp = ThingStatement(
            "home",
            LAMP,
            ThingKey.of(new_signer().public_key, KID),
            self.home.identity(self.site.now()).thumbprint,
            self.now - 60,
            self.now + 600,
            bytes(16),
        )

    def confirm(self) -> None:
        """The master says that the newest list is the newest."""
        data = self.site.authority.store.newest_list()
        assert data is not None
        if self.revocations.data != data:
            self.revocations.update(data, self.now)
        seq = open_list(data, self.site.anchor.public_key).seq
        self.revocations.confirm(Timestamp(seq, digest(data), self.now, MAX_AGE), self.now)

    def install(self, *statements: ThingStatement) -> None:
        for each in statements:
            self.files.install(sign_statement(self.site.authority.signer, each))

    def revoke(self, entry: bytes) -> None:
        self.site.authority.revoke(entry, "test", self.now)
        self.confirm()


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path / "home")


def test_nothing_is_served_at_first(place: Place) -> None:
    assert place.roster.reload()
    assert not place.roster.reload()
    assert (len(place.roster), place.roster.names) == (0, [])
    assert place.roster.by_key(KID) is None
    assert place.roster.by_secret(KID) is None
    assert place.roster.statement(LAMP) is None
    assert not place.roster.is_served(LAMP, place.lamp.credential.thumbprint)


def test_a_thing_with_a_key_is_served_at_once(place: Place) -> None:
    assert place.roster.by_key(KID) is None
    place.install(place.lamp)
    assert place.roster.by_key(KID) == (LAMP, place.lamp.credential)
    assert place.roster.by_secret(KID) is None
    assert place.roster.statement(LAMP) == place.lamp
    assert place.roster.is_served(LAMP, place.lamp.credential.thumbprint)
    assert not place.roster.is_served(LAMP, bytes(32))
    assert place.roster.entries() == [place.lamp.id, place.lamp.credential.thumbprint]
    place.files.forget(LAMP)
    assert place.roster.by_key(KID) is None


def test_a_thing_with_a_secret_needs_the_one_that_was_stated(
    place: Place, caplog: pytest.LogCaptureFixture
) -> None:
    secret = place.files.create_secret(LAMP)
    place.install(replace(place.lamp, credential=ThingSecret.of(secret, b"\x07")))
    assert place.roster.by_secret(b"\x07") == (LAMP, secret)
    assert place.roster.by_key(b"\x07") is None
    other = place.files.path / "things.lamp.key"
    other.unlink()
    place.files.create_secret(LAMP)
    for _ in range(2):
        assert place.roster.by_secret(b"\x07") is None
    assert caplog.text.count("not about the secret that is here") == 1


def test_a_statement_ends_with_its_time(place: Place) -> None:
    place.install(place.lamp)
    credential = place.lamp.credential.thumbprint
    place.now = place.lamp.expires - 1
    place.confirm()
    assert place.roster.by_key(KID) is not None
    assert place.roster.is_served(LAMP, credential)
    place.now += 1
    assert place.roster.by_key(KID) is None
    assert not place.roster.is_served(LAMP, credential)


@pytest.mark.parametrize("what", ["statement", "credential"])
def test_a_statement_or_a_key_is_revoked(place: Place, what: str) -> None:
    place.install(place.lamp)
    credential = place.lamp.credential.thumbprint
    assert place.roster.by_key(KID) is not None
    place.revoke(place.lamp.id if what == "statement" else credential)
    assert place.roster.by_key(KID) is None
    assert not place.roster.is_served(LAMP, credential)


def test_nobody_new_is_served_while_nothing_is_known_of_revocations(place: Place) -> None:
    place.install(place.lamp)
    place.now += 300  # the master's word is older than it may be, the statement is in time
    place.lamp = again(place.lamp, 2, not_before=place.now - 9, expires=place.now + 9999)
    place.install(place.lamp)
    place.now += 3600
    assert place.roster.by_key(KID) is None
    assert place.roster.is_served(LAMP, place.lamp.credential.thumbprint)


def test_a_thing_that_was_renamed_is_served_under_its_new_name(place: Place) -> None:
    """Whatever the order of its files, and however fast it was done."""
    for name in ("/kitchen/lamp", "/zoo/lamp"):
        renamed = again(place.lamp, 2, name=name)
        place.install(place.lamp, renamed)
        place.revoke(place.lamp.id)
        assert place.roster.by_key(KID) == (name, place.lamp.credential)
        place.files.forget(name)
        place.lamp = again(place.lamp, 3)


def test_of_two_things_with_a_kid_the_newer_counts(place: Place) -> None:
    newer = again(
        place.lamp,
        2,
        name="/a/lamp",
        not_before=place.lamp.not_before + 5,
        credential=ThingKey.of(new_signer().public_key, KID),
    )
    place.install(place.lamp, newer)
    assert place.roster.by_key(KID) == ("/a/lamp", newer.credential)
    place.revoke(newer.id)
    assert place.roster.by_key(KID) == (LAMP, place.lamp.credential)


def test_what_is_written_in_the_same_moment_is_read_a_second_later(place: Place) -> None:
    place.install(place.lamp)
    moment = place.files.path.stat().st_mtime_ns
    place.now = moment // 10**9
    assert place.roster.reload()
    fan = again(place.lamp, 2, name="/things/fan")
    place.install(fan)
    os.utime(place.files.path, ns=(moment, moment))  # a file system with coarse times
    assert not place.roster.reload()
    place.now += 1
    assert place.roster.reload()
    assert place.roster.names == ["/things/fan", LAMP]
    place.now += 2
    assert place.roster.reload()
    place.now += 1
    assert not place.roster.reload()
