"""Lists of an authority on the same host: accepted when newer; failures are only logged."""

from pathlib import Path

import pytest

from ca.errors import RevocationRefused
from ca.revocation.trust_status import Revocations
from rossec.errors import ConfigurationError
from rossec.master.rights.statements import TrustState
from rossec.master.server.maintenance import LocalAuthority, no_authority
from tests.rossec.master.fakes import FakeStatements
from tests.support import trust
from tests.support.site import Site


class Found:
    def __init__(self) -> None:
        self.there: tuple[bytes, bytes] | Exception | None = None
        self.statements = FakeStatements()
        self.local_authority = LocalAuthority(self.find, self.statements)

    def find(self) -> tuple[bytes, bytes] | None:
        if isinstance(self.there, Exception):
            raise self.there
        return self.there


def test_a_newer_list_is_accepted() -> None:
    found = Found()
    for there, newer in (
        (None, False),
        ((b"list 1", b""), True),
        ((b"list 1", b""), False),
        ((b"list 2", b""), True),
    ):
        found.there = there
        assert found.local_authority.has_newer_list(7) is newer
    assert found.statements.lists == [b"list 1", b"list 2"]


def test_without_an_authority_nothing_is_accepted() -> None:
    found = Found()
    assert not LocalAuthority(no_authority, found.statements).has_newer_list(7)
    assert found.statements.lists == []


def test_a_tree_is_accepted_with_its_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.master.server.maintenance.is_tree", lambda data: data == b"tree")
    found = Found()
    found.there = b"tree", b" and entries"
    found.local_authority.has_newer_list(7)
    assert found.statements.lists == [b"tree and entries"]


@pytest.mark.parametrize(
    "wrong", [(b"forged", b""), RevocationRefused("no"), ConfigurationError("none signed", "x"), OSError()]
)
def test_a_failure_is_logged(
    wrong: tuple[bytes, bytes] | Exception, caplog: pytest.LogCaptureFixture
) -> None:
    found = Found()
    found.there = wrong
    assert not found.local_authority.has_newer_list(7)
    assert found.statements.lists == []
    assert "the list of the authority on this host is not accepted" in caplog.text


def test_each_reason_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    found = Found()
    for there in (ConfigurationError("one", ""), ConfigurationError("another", "")):
        found.there = there
        for _ in range(3):
            found.local_authority.has_newer_list(7)
    assert caplog.text.count("is not accepted") == 2
    found.there = None
    found.local_authority.has_newer_list(7)
    found.there = ConfigurationError("another", "")
    found.local_authority.has_newer_list(7)
    assert caplog.text.count("is not accepted: another") == 2


def test_a_newer_list_of_domains_is_accepted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    home, hospital = Site(tmp_path / "home", "home"), Site(tmp_path / "hospital", "hospital")
    there = [b""]
    revocations = Revocations(home.anchor.public_key)
    statements = TrustState(home.anchor, home.authority.signer, revocations, lambda _data: None)
    local = LocalAuthority(no_authority, statements, lambda: there[0])
    assert not local.has_newer_domains()
    old = there[0] = trust.accept(home, hospital)
    assert local.has_newer_domains()
    assert not local.has_newer_domains()
    assert statements.domains.anchors.data == old
    there[0] = trust.remove(home, "hospital")
    assert local.has_newer_domains()
    there[0] = old
    for _ in range(3):
        assert not local.has_newer_domains()
        assert not local.has_newer_list(7)
    assert caplog.text.count("the list of domains of the authority on this host is not") == 1
    assert not LocalAuthority(no_authority, statements).has_newer_domains()
    for site in (home, hospital):
        site.authority.store.close()
