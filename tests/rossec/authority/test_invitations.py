from dataclasses import replace
from pathlib import Path

import pytest

from ca.enrollment.join import RefuseReason
from ca.errors import NameRefused, PatternRefused
from ca.revocation.lists import open_list
from ca.things import sign_statement
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import InvitationStatus, end, find, invitations, invite, revoke_nodes
from rossec.errors import ConfigurationError
from tests.support.joining import HOUR, JoinSite, issued, refusal
from tests.support.pki import NOW, new_signer
from tests.support.things import LAMP, row_of

PASSPHRASE = "four random words here"
END = NOW + HOUR


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> AuthorityHome:
    root = tmp_path_factory.mktemp("home")
    root.chmod(0o700)
    return AuthorityHome.create(root, "home", PASSPHRASE, NOW)


@pytest.fixture
def home(tmp_path: Path) -> JoinSite:
    return JoinSite(tmp_path / "site")


def status(home: JoinSite) -> InvitationStatus:
    return invitations(home.store)[-1]


def test_an_invitation_is_recorded_without_its_secret(directory: AuthorityHome) -> None:
    code = invite(directory, "/fleet/*", 3, END, "10.0.0.1:11318", NOW)
    store = directory.store()
    found = invitations(store)[-1]
    store.close()
    assert (found.row.id, found.row.key, found.row.pattern) == (code.id, code.key, "/fleet/*")
    assert (found.row.uses, found.row.expires, found.row.wildcard) == (3, END, False)
    assert (found.uses, found.ended, found.short_id) == ([], None, code.id.hex()[:8])
    assert code.secret not in directory.path.joinpath("ca.db").read_bytes()
    other = invite(directory, "/fleet/*", 3, END, "10.0.0.1:11318", NOW)
    assert other.secret != code.secret


@pytest.mark.parametrize(
    ("pattern", "wildcard", "error"),
    [
        ("fleet", False, PatternRefused),
        ("/fleet*", False, PatternRefused),
        ("/master", False, ConfigurationError),
        ("/ca", False, ConfigurationError),
        ("/ca", True, NameRefused),
        ("/gateway", False, ConfigurationError),
        ("/gateway/*", False, ConfigurationError),
        ("/gateway", True, NameRefused),
    ],
)
def test_what_is_not_invited(
    directory: AuthorityHome, pattern: str, wildcard: bool, error: type[Exception]
) -> None:
    with pytest.raises(error):
        invite(directory, pattern, 1, END, "10.0.0.1:11318", NOW, wildcard=wildcard)


def test_the_states(home: JoinSite) -> None:
    code = home.invite()
    assert status(home).state(NOW) == "open"
    assert status(home).state(END + 1) == "expired"
    home.join(code)
    assert status(home).state(NOW) == "used up"
    home.store.invitations.end(code.id, "lost", NOW)
    assert status(home).state(END + 1) == "ended: lost"


def test_one_is_found_by_the_beginning_of_its_id(home: JoinSite) -> None:
    code = home.invite()
    assert find(home.store, code.id.hex()[:8].upper()).row.id == code.id
    for beginning in ("", "zz"):
        with pytest.raises(ConfigurationError, match="no invitation begins"):
            find(home.store, beginning)
    for _ in range(16):
        home.invite()
    shared = next(
        digit
        for digit in "0123456789abcdef"
        if sum(each.row.id.hex().startswith(digit) for each in invitations(home.store)) > 1
    )
    with pytest.raises(ConfigurationError, match="several invitations begin"):
        find(home.store, shared)


def test_the_end_denies_what_waits_because_of_it(home: JoinSite) -> None:
    code, other = home.invite(uses=5), home.invite(uses=5)
    issued(home.join(code, "/fleet/a"))
    for by in (code, other):
        home.join(by, "/fleet/a")
    assert end(home.store, find(home.store, code.id.hex()), "lost", NOW) == 1
    [left] = home.store.requests.open()
    assert left.source == f"invitation {other.id.hex()[:8]}"
    assert refusal(home.join(code, "/fleet/b")) is RefuseReason.ENDED
    assert end(home.store, find(home.store, code.id.hex()), "again", NOW) == 0
    assert find(home.store, code.id.hex()).ended == "lost"


def test_every_key_of_who_joined_is_revoked_in_one_list(home: JoinSite) -> None:
    code, other = home.invite(uses=5), home.invite(uses=5)
    keys = [new_signer() for _ in range(3)]
    ours = [issued(home.join(code, f"/fleet/{n}", key)) for n, key in zip("ab", keys, strict=False)]
    kept = issued(home.join(other, "/fleet/c", keys[2]))
    before = home.store.next_number()
    listed, names = revoke_nodes(home.authority, status_of(home, code.id), "lost", NOW)
    assert names == ["/fleet/a", "/fleet/b"]
    assert home.store.next_number() == (before[0], before[1] + 1)
    newest = home.store.newest_list()
    assert listed is not None
    assert newest is not None
    entries = open_list(newest, home.site.anchor.public_key).entries
    prints = [home.authority.verify(der, NOW).thumbprint for der in (*ours, kept)]
    assert [each in entries for each in prints] == [True, True, False]
    assert revoke_nodes(home.authority, status_of(home, code.id), "lost", NOW) == (None, [])


def test_the_things_of_a_router_that_joined_end_with_it(home: JoinSite) -> None:
    code = home.invite(uses=5)
    issued(home.join(code, "/fleet/a"))
    lamp = replace(LAMP, not_before=NOW, expires=NOW + HOUR)
    data = sign_statement(home.authority.signer, lamp)
    row = row_of(lamp, "/fleet/a")._replace(data=data)
    home.store.things.add(row, lamp, NOW)
    listed, _ = revoke_nodes(home.authority, status_of(home, code.id), "lost", NOW)
    assert listed is not None
    assert lamp.id in listed.entries


def status_of(home: JoinSite, code_id: bytes) -> InvitationStatus:
    return find(home.store, code_id.hex())


def test_the_end_denies_also_what_was_approved_and_not_issued(home: JoinSite) -> None:
    code = home.invite(uses=5)
    issued(home.join(code, "/fleet/a"))
    home.join(code, "/fleet/a")
    [waits] = home.store.requests.open()
    home.store.requests.approve(waits.digest, NOW, replace_key="/fleet/a")
    assert end(home.store, find(home.store, code.id.hex()), "lost", NOW) == 1
    assert home.store.requests.get(waits.digest).reason == "its invitation was ended: lost"
