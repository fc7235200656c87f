"""Who tries to be a thing that it is not, by what the authority says, or has said, of things."""

from dataclasses import replace
from pathlib import Path

import pytest

from ca.encoding import encode
from ca.errors import LogDamaged, StoreError, ThingOutdated, ThingRefused
from ca.keys import passphrases
from ca.keys.signing import Profile
from ca.store.record import Store
from ca.things import THING, ThingSecret, open_statement, read_ccs, sign_statement
from rossec.authority.backup import back_up
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support import refusal_texts
from tests.support.commands import Shell
from tests.support.pki import new_signer
from tests.support.thingoffice import ATTIC, BORDER, DAY, LAMP, PASSPHRASE, Office
from tests.vectors.make_things import cose_key


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Office:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    return Office(tmp_path / "home")


def router(office: Office, name: str = BORDER) -> ThingFiles:
    return ThingFiles(NodeHome.of(office.root, name))


@pytest.mark.attack("thing-statement")
def test_a_statement_that_the_authority_did_not_make(office: Office) -> None:
    genuine = office.sign()
    key, said = office.home.anchor().public_key, genuine.statement
    mallory = replace(said, credential=office.key(b"\x2b"))
    grant = Profile("rossec-grant+cwt").sign(office.service.unlock().signer, {2: LAMP})
    forged = (
        sign_statement(new_signer(), mallory),
        sign_statement(office.service.unlock().signer, replace(said, domain="hospital")),
        genuine.data[:-64] + sign_statement(new_signer(), said)[-64:],
        genuine.data.replace(LAMP.encode(), b"/things/door"),
        grant,
    )
    for data in forged:
        with pytest.raises(ThingRefused):
            router(office).install(data)
        with pytest.raises(ThingRefused):
            open_statement(data, key, office.now, domain="home")
    assert router(office).load() == ({}, {})


@pytest.mark.attack("thing-statement")
def test_a_statement_for_another_router_or_from_before(office: Office) -> None:
    older = office.sign()
    office.now += 100
    newer = office.service.things.renew(LAMP, DAY)
    with pytest.raises(ThingRefused, match="for another border router"):
        router(office, ATTIC).install(newer.data)
    files = router(office)
    files.install(newer.data)
    with pytest.raises(ThingRefused, match="older than the one that is here"):
        files.install(older.data)
    copied = router(office, ATTIC)
    copied.path.mkdir(mode=0o700)
    (copied.path / "things.lamp.cose").write_bytes(newer.data)  # as who can write files does
    assert copied.load().statements == {}
    assert files.load().statements == {LAMP: newer.statement}
    with pytest.raises(ThingOutdated):
        newer.statement.check_time(office.now + DAY)


@pytest.mark.attack("thing-statement")
def test_a_secret_that_was_not_stated(office: Office) -> None:
    files = router(office)
    secret = files.create_secret(LAMP)
    signed = office.sign(credential=ThingSecret.of(secret, b"\x01"))
    files.install(signed.data)
    (files.path / "things.lamp.key").write_bytes(bytes(16))  # a secret that another knows
    with pytest.raises(ThingRefused, match="not about the secret that is here"):
        files.secret_of(signed.statement)


@pytest.mark.attack("thing-statement")
@pytest.mark.parametrize(
    "key", [cose_key(n3=True), cose_key(n4=bytes(32)), cose_key(k2=b""), cose_key(n3=bytes(32))]
)
def test_a_credential_of_another_form(office: Office, key: dict[int | str, object]) -> None:
    """Such as a point beside the curve, which would tell a static key bit by bit."""
    data = encode({8: {1: key}})  # type: ignore[dict-item]
    with pytest.raises(Exception, match=r"not a P-256 key|a kid of 0|not a point") as caught:
        read_ccs(data)
    assert caught.type.__module__ == "ca.errors"
    claims = {
        2: LAMP,
        3: "home",
        4: office.now + 9,
        5: office.now,
        7: bytes(16),
        8: {1: key},
        -70035: office.thumbprint(BORDER),
    }
    with pytest.raises(ThingRefused):
        router(office).install(THING.sign(office.service.unlock().signer, claims))  # type: ignore[arg-type]


@pytest.mark.attack("thing-impostor")
def test_another_things_name_key_or_kid(office: Office) -> None:
    office.sign(request=office.request(), identity_lifetime=DAY)
    mallory = office.key(b"\x66")
    for changes in (
        {"credential": mallory},
        {"border": ATTIC},
        {"name": "/things/door"},
        {"name": "/things/door", "border": ATTIC},
        {"name": "/things/door", "credential": replace(mallory, kid=b"\x2b")},
    ):
        with pytest.raises(StoreError, match=refusal_texts.THING_CHANGED):
            office.sign(**changes)
    with pytest.raises(StoreError):  # the name's identity, with another key
        office.sign(request=office.request(), identity_lifetime=DAY)
    assert [each.state for each in office.service.things.states()] == ["in force"]


@pytest.mark.attack("thing-impostor")
def test_the_name_of_its_own_router(office: Office) -> None:
    """Such a thing would speak with the identity and the grants of the router."""
    with pytest.raises(ThingRefused, match="is the border router"):
        office.sign(name=BORDER)
    said = replace(office.sign().statement, name=BORDER)
    with pytest.raises(ThingRefused, match="is the border router"):
        router(office).install(sign_statement(office.service.unlock().signer, said))


@pytest.mark.attack("thing-impostor")
def test_what_a_thing_was_ends_with_what_it_is(office: Office) -> None:
    former = office.sign(request=office.request(), identity_lifetime=DAY)
    node = office.thumbprint(LAMP)
    office.sign(name="/things/light", replaced=frozenset({LAMP}))
    assert {former.statement.id, node} == set(office.revoked())
    moved = office.sign(name="/things/light", border=ATTIC, replaced=frozenset({"/things/light"}))
    assert len(office.revoked()) == 3
    assert moved.statement.id not in office.revoked()


@pytest.mark.attack("stolen-router")
@pytest.mark.parametrize("how", ["revoked", "set up anew"])
def test_the_keys_of_a_stolen_router_are_of_no_use(office: Office, how: str) -> None:
    names = [f"/things/lamp{number}" for number in range(3)]
    ids = set()
    for number, name in enumerate(names):
        signed = office.sign(
            name=name,
            credential=office.key(bytes([number])),
            request=office.request(name),
            identity_lifetime=DAY,
        )
        ids.add(signed.statement.id)
    stolen = {office.thumbprint(name) for name in (BORDER, *names)}
    if how == "revoked":
        office.service.identities.revoke(BORDER, "stolen")
    else:
        office.enroll(BORDER, replaced=BORDER)
    assert stolen | ids == set(office.revoked())
    for name in names:
        with pytest.raises(StoreError, match="is revoked"):
            office.thumbprint(name)


@pytest.mark.attack("thing-secret")
def test_a_secret_is_nowhere_but_at_its_router(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shell = Shell(tmp_path / "home", capsys)
    monkeypatch.chdir(shell.root)
    assert shell.unlocked("ca", "init", "home").code == 0
    shell.enroll(BORDER)
    added = shell("border", "add", LAMP, "--psk", "--secret-out", "lamp.secret")
    described = str(shell.node(BORDER) / "things" / "things.lamp.psk")
    signed = shell.unlocked("ca", "thing", LAMP, "--border", BORDER, "--psk", described, "--yes")
    labels = shell("border", "labels", described, "--out", "labels.html")
    log = shell("ca", "log")
    shown = shell("ca", "things", "--json")
    assert {each.code for each in (added, signed, labels, log, shown)} == {0}
    secret = (shell.node(BORDER) / "things" / "things.lamp.key").read_bytes()
    printed = "".join(each.out + each.err for each in (added, signed, labels, log, shown))
    written = b"".join(
        path.read_bytes()
        for path in shell.root.rglob("*")
        if path.is_file() and path.name not in {"lamp.secret", "things.lamp.key"}
    )
    assert secret.hex() not in printed.lower()
    assert secret not in written
    assert secret.hex().encode() not in written.lower()


@pytest.mark.attack("thing-secret")
def test_a_backup_of_the_authority_has_no_secret(office: Office) -> None:
    secret = router(office).create_secret(LAMP)
    office.sign(credential=ThingSecret.of(secret, b"\x01"))
    content = passphrases.unseal(back_up(office.home, PASSPHRASE), PASSPHRASE)
    assert "ca.db" in content
    assert not any(secret in data for data in content.values())


@pytest.mark.attack("rewritten-record")
def test_a_thing_that_was_written_into_the_record_is_found(office: Office) -> None:
    """By who can write the record and its log, but has not the key."""
    office.sign()
    store = Store.open(office.home.path / "ca.db")
    row = store.things.get(LAMP, office.now)
    mallory = replace(row.read(), name="/things/door", credential=office.key(b"\x66"), serial=bytes(16))
    data = sign_statement(new_signer(), mallory)
    store.things.add(row._replace(id=mallory.id, name=mallory.name, data=data), mallory, office.now)
    with pytest.raises(LogDamaged, match="not a statement of this authority"):
        store.log.audit(office.home.anchor().public_key)
    store.close()
