import time
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations
from grants.errors import GrantMissing
from grants.model import Right
from rossec.errors import ConnectionHeaderRefused
from rossec.participant import handshakes
from rossec.participant.access import Access
from rossec.participant.handshakes import Fields
from tests.support.domains import alone
from tests.support.openaccess import OpenAccess
from tests.support.site import Site

NOW = int(time.time())
SERVICE = "/door/open"


class Pair:
    """A server and a client that hold the grants they need."""

    def __init__(self, root: Path) -> None:
        site = Site(root, clock=lambda: NOW)
        site.grant("/door", Right.PROVIDE, SERVICE)
        site.grant("/hall", Right.CALL, SERVICE)
        self.forwarded_port, self.hall = site.identity("/door"), site.identity("/hall")
        self.forwarded_port_access, self.hall_access = (
            self._access(site, "/door"),
            self._access(site, "/hall"),
        )

    def _access(self, site: Site, name: str) -> Access:
        held = Revocations(site.anchor.public_key)
        data = site.authority.store.newest_list()
        assert data is not None
        held.update(data, NOW)
        held.confirm(Timestamp(1, digest(data), NOW, 30), NOW)
        return Access(alone(site.anchor, held), site.enroll(name).grants())

    def request(self) -> Fields:
        proof = handshakes.caller_proof(SERVICE, self.hall_access, NOW)
        return {"callerid": b"/hall", "service": SERVICE.encode(), **proof}

    def answer(self) -> Fields:
        return {"callerid": b"/door", **handshakes.provider_proof(SERVICE, self.forwarded_port_access, NOW)}

    def admit_hall(self, fields: Fields, peer: Identity | None = None) -> None:
        handshakes.admit_caller(fields, peer or self.hall, self.forwarded_port_access, NOW)

    def admit_forwarded_port(self, fields: Fields) -> None:
        handshakes.admit_provider(fields, self.forwarded_port, SERVICE, self.hall_access, NOW)


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    return Pair(tmp_path / "site")


def test_the_two_headers_admit_each_other(pair: Pair) -> None:
    pair.admit_hall(pair.request())
    pair.admit_forwarded_port(pair.answer())
    assert handshakes.requested_service(pair.request()) == SERVICE


def test_a_client_needs_the_right_to_call(pair: Pair) -> None:
    other = {**pair.request(), "service": b"/door/lock"}
    with pytest.raises(GrantMissing):
        pair.admit_hall(other)
    with pytest.raises(GrantMissing):
        pair.admit_hall({**pair.answer(), "service": SERVICE.encode()}, pair.forwarded_port)


def test_a_server_needs_the_right_to_provide(pair: Pair) -> None:
    bare = pair.answer()
    del bare["rossec_grants"]
    with pytest.raises(GrantMissing):
        pair.admit_forwarded_port(bare)


def test_a_callerid_must_match_the_certificate(pair: Pair) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="calls itself"):
        pair.admit_hall({**pair.request(), "callerid": b"/door"})
    with pytest.raises(ConnectionHeaderRefused, match="calls itself"):
        pair.admit_forwarded_port({**pair.answer(), "callerid": b"/hall"})


def test_an_error_of_the_server_is_quoted(pair: Pair) -> None:
    with pytest.raises(ConnectionHeaderRefused, match=r"^/door refuses: closed$"):
        pair.admit_forwarded_port({"error": b"closed"})


def test_a_header_without_a_service_is_refused(pair: Pair) -> None:
    question = pair.request()
    del question["service"]
    with pytest.raises(ConnectionHeaderRefused, match="'service'"):
        pair.admit_hall(question)


def test_headers_of_client_and_server(pair: Pair) -> None:
    kind = handshakes.ExpectedService("std_srvs/SetBool", "09fb03525b03e7ea1fd3992bafd87e16")
    asked = handshakes.client_header("/hall", SERVICE, kind, pair.hall_access, NOW, persistent=True)
    pair.admit_hall(asked)
    assert handshakes.is_set(asked, "persistent")
    assert not handshakes.is_set(asked, "probe")
    answer = handshakes.server_header("/door", SERVICE, kind, pair.forwarded_port_access, NOW)
    handshakes.admit_provider(answer, pair.forwarded_port, SERVICE, pair.hall_access, NOW)
    for fields in (asked, answer):
        handshakes.check_md5(fields, SERVICE, kind.md5sum)
        assert fields["type"] == b"std_srvs/SetBool"
    assert answer["request_type"] == b"std_srvs/SetBoolRequest"


def test_a_probe_matches_any_type(pair: Pair) -> None:
    asked = handshakes.client_header("/hall", SERVICE, handshakes.ANY, pair.hall_access, NOW, probe=True)
    assert handshakes.is_set(asked, "probe")
    assert asked["md5sum"] == b"*"
    handshakes.check_md5(asked, SERVICE, "0" * 32)


@pytest.mark.parametrize(
    ("value", "means"), [(b"1", True), (b"true", True), (b"True", True), (b"0", False), (b"", False)]
)
def test_flags_are_read_as_stock_clients_write_them(value: bytes, means: bool) -> None:
    assert handshakes.is_set({"probe": value}, "probe") is means
    assert not handshakes.is_set({}, "probe")


def test_md5sums_must_agree() -> None:
    handshakes.check_md5({"md5sum": b"a"}, SERVICE, "*")
    with pytest.raises(ConnectionHeaderRefused, match="/door/open has the md5sum b here, a at the peer"):
        handshakes.check_md5({"md5sum": b"a"}, SERVICE, "b")
    with pytest.raises(ConnectionHeaderRefused, match="has no 'md5sum'"):
        handshakes.check_md5({}, SERVICE, "b")


ALIAS = "/remote/hospital/door/open"


def test_the_header_for_an_alias_has_the_origins_name_and_access_the_alias(pair: Pair) -> None:
    access = OpenAccess()
    fields = handshakes.client_header("/hall", ALIAS, handshakes.ANY, access, NOW)
    assert fields["service"] == b"/door/open"
    assert access.presented == [("call", ALIAS)]
    handshakes.admit_provider(pair.answer(), pair.forwarded_port, ALIAS, access, NOW)
    assert access.authorized == [("/door", "provide", ALIAS)]


def test_a_client_that_asks_for_an_alias_is_refused(pair: Pair) -> None:
    access = OpenAccess()
    fields = pair.request() | {"service": ALIAS.encode()}
    with pytest.raises(ConnectionHeaderRefused, match="no name on the wire"):
        handshakes.admit_caller(fields, pair.hall, access, NOW)
    assert access.authorized == []
