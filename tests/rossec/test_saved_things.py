"""What a border router has of its things, on disk."""

from dataclasses import replace
from pathlib import Path

import pytest

from ca.errors import CAError, PathRefused, ThingRefused
from ca.keys.signing import thumbprint
from ca.things import ThingKey, ThingSecret, ThingStatement, read_description, sign_statement
from rossec import saved_statements
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support.site import Site
from tests.support.things import again
from tests.vectors.make_things import LAMP as LAMP_KEY
from tests.vectors.make_things import OTHER, STATEMENTS

LAMP = "/things/lamp"


class Router:
    """An enrolled border router, and the authority's statements about its things."""

    def __init__(self, root: Path) -> None:
        self.site = Site(root)
        self.home = self.site.enroll("/border")
        self.files = ThingFiles(self.home)
        self.now = self.site.now()
        self.lamp = ThingStatement(
            "home",
            LAMP,
            ThingKey.of(LAMP_KEY.public_key, b"\x2b"),
            self.home.identity(self.now).thumbprint,
            self.now,
            self.now + 60,
            bytes(16),
        )

    def sign(self, statement: ThingStatement) -> bytes:
        return sign_statement(self.site.authority.signer, statement)


@pytest.fixture
def router(tmp_path: Path) -> Router:
    return Router(tmp_path / "home")


def test_a_statement_is_kept_until_it_is_forgotten(router: Router) -> None:
    assert router.files.load() == ({}, {})
    for _ in range(2):
        assert router.files.install(router.sign(router.lamp)) == router.lamp
    assert router.files.load() == ({LAMP: router.lamp}, {})
    assert [path.name for path in router.files.path.iterdir()] == ["things.lamp.cose"]
    assert router.files.forget(LAMP)
    assert not router.files.forget(LAMP)
    assert router.files.load().statements == {}


def test_an_older_statement_does_not_replace_a_newer_one(router: Router) -> None:
    newer = again(router.lamp, 2, not_before=router.now + 1)
    router.files.install(router.sign(newer))
    with pytest.raises(ThingRefused, match="older than the one that is here"):
        router.files.install(router.sign(router.lamp))
    assert router.files.load().statements == {LAMP: newer}


def test_a_statement_for_another_router_is_refused(router: Router) -> None:
    other = replace(router.lamp, border=STATEMENTS["a key"].border)
    with pytest.raises(ThingRefused, match="for another border router") as caught:
        router.files.install(router.sign(other))
    assert "rossec ca thing /things/lamp --border /border" in caught.value.hint


@pytest.mark.parametrize("flaw", ["forged", "another domain", "cut"])
def test_what_is_not_the_authoritys_is_refused(router: Router, flaw: str) -> None:
    data = router.sign(router.lamp)
    if flaw == "forged":
        data = sign_statement(OTHER, router.lamp)
    elif flaw == "another domain":
        data = router.sign(replace(router.lamp, domain="hospital"))
    else:
        data = data[:-1]
    with pytest.raises(ThingRefused):
        router.files.install(data)
    assert not router.files.path.exists()


def test_a_file_that_is_none_is_named_and_left_out(router: Router) -> None:
    router.files.install(router.sign(router.lamp))
    fan = replace(router.lamp, name="/things/fan")
    path = router.files.path / "things.door.cose"
    path.write_bytes(router.sign(fan))
    damaged = router.files.path / "things.tap.cose"
    damaged.write_bytes(b"tap")
    loaded = router.files.load()
    assert loaded.statements == {LAMP: router.lamp}
    assert str(loaded.refused[path]) == "things.door.cose is about /things/fan"
    assert "not a statement" in str(loaded.refused[damaged])
    router.files.install(router.sign(replace(fan, name="/things/tap")))
    assert damaged not in router.files.load().refused


def test_there_are_not_more_than_so_many(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saved_statements, "MAX_THINGS", 1)
    router.files.install(router.sign(router.lamp))
    router.files.install(router.sign(router.lamp))
    with pytest.raises(ConfigurationError, match="has 1 things, and takes no more"):
        router.files.install(router.sign(replace(router.lamp, name="/things/fan")))


def test_a_secret_is_made_once_and_read_by_its_owner_alone(router: Router) -> None:
    with pytest.raises(ConfigurationError, match="there is no secret of /things/lamp") as caught:
        router.files.secret(LAMP)
    assert "rossec border add /things/lamp --psk" in caught.value.hint
    secret = router.files.create_secret(LAMP)
    assert (len(secret), router.files.secret(LAMP)) == (16, secret)
    path = router.files.path / "things.lamp.key"
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(ConfigurationError, match="exists and is not overwritten"):
        router.files.create_secret(LAMP)
    assert router.files.secret(LAMP) == secret
    path.chmod(0o640)
    with pytest.raises((ConfigurationError, PathRefused), match="others"):
        router.files.secret(LAMP)
    assert router.files.forget(LAMP)
    assert router.files.create_secret(LAMP) != secret


def test_the_secret_must_be_the_one_that_was_stated(router: Router) -> None:
    secret = router.files.create_secret(LAMP)
    stated = replace(router.lamp, credential=ThingSecret.of(secret, b"\x07"))
    assert router.files.secret_of(stated) == secret
    other = replace(router.lamp, credential=ThingSecret.of(bytes(16), b"\x07"))
    for statement in (other, router.lamp):
        with pytest.raises(ThingRefused, match="not about the secret that is here"):
            router.files.secret_of(statement)


def test_a_kid_that_is_free(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    taken = replace(router.lamp, credential=ThingSecret.of(bytes(16), b"kk"))
    router.files.install(router.sign(taken))
    kids = [b"kk", b"kk", b"ff"]
    monkeypatch.setattr("secrets.token_bytes", lambda _: kids.pop(0))
    assert router.files.free_kid() == b"ff"
    kids = [b"kk"] * 64
    with pytest.raises(ConfigurationError, match="no kid is free"):
        router.files.free_kid()


def test_a_secret_is_described_in_a_file_that_may_be_read(router: Router) -> None:
    known = ThingSecret.of(router.files.create_secret(LAMP), b"kk")
    path = router.files.describe_secret(LAMP, known)
    assert read_description(path.read_bytes()) == known
    router.files.forget(LAMP)
    assert not path.exists()


def test_the_routers_key_for_things_is_made_once(router: Router) -> None:
    """It is another one than that of its node, which signs."""
    made = router.files.router_key()
    again = ThingFiles(router.home).router_key()
    assert thumbprint(made.public_key()) == thumbprint(again.public_key())
    assert thumbprint(made.public_key()) != router.home.identity(router.now).thumbprint
    path = router.files.path / saved_statements.ROUTER_KEY
    assert path.stat().st_mode & 0o777 == 0o600
    assert router.files.load() == ({}, {})
    path.chmod(0o644)
    with pytest.raises(CAError):
        router.files.router_key()


def test_long_names_have_files(router: Router) -> None:
    name = "/things/" + "a" * 240
    router.files.install(router.sign(replace(router.lamp, name=name)))
    router.files.create_secret(name)
    assert router.files.load().statements.keys() == {name}


def test_statements_of_a_former_key_are_replaced(router: Router, tmp_path: Path) -> None:
    path = router.files.path / "things.lamp.cose"
    router.files.install(router.sign(again(router.lamp, 2, not_before=router.now + 9)))
    path.write_bytes(router.sign(replace(router.lamp, border=bytes(32), not_before=router.now + 9)))
    assert path in router.files.load().refused
    router.files.install(router.sign(router.lamp))
    assert router.files.load() == ({LAMP: router.lamp}, {})
    assert NodeHome.of(tmp_path / "home", "/border").path == router.home.path


@pytest.mark.parametrize("name", [".router", "/.router", "things.lamp", "/../lamp", ""])
def test_only_a_thing_is_forgotten(router: Router, name: str) -> None:
    router.files.router_key()
    router.files.install(router.sign(router.lamp))
    before = sorted(router.files.path.iterdir())
    with pytest.raises(CAError):
        router.files.forget(name)
    assert sorted(router.files.path.iterdir()) == before
