from dataclasses import replace

import pytest

from ca.svid import build_request
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.handshakes import check_caller, refuse_on_wire, text
from tests.support.pki import NOW, Site, new_signer

SITE = Site.create()


def test_a_caller_is_named_by_its_certificate() -> None:
    csr = build_request(new_signer(), "home", "/rviz")
    single, anonymous = (
        SITE.anchor.verify([SITE.authority.issue(csr, now=NOW, serial=1, wildcard=tail)], NOW)
        for tail in (False, True)
    )
    check_caller({"callerid": b"/rviz"}, single)
    check_caller({"callerid": b"/rviz_17"}, anonymous)
    with pytest.raises(ConnectionHeaderRefused, match="certified as /rviz calls itself /rviz_17") as caught:
        check_caller({"callerid": b"/rviz_17"}, single)
    assert "the name it was enrolled with" in caught.value.hint
    with pytest.raises(ConnectionHeaderRefused, match="has no 'callerid'"):
        check_caller({}, single)


@pytest.mark.parametrize(
    ("value", "message"),
    [(b"\xff", "'topic' is not text"), (b"/a\x1b[2J", "'topic' holds control characters")],
)
def test_a_field_that_is_not_text_is_refused(value: bytes, message: str) -> None:
    with pytest.raises(ConnectionHeaderRefused, match=message):
        text({"topic": value}, "topic")


def test_an_error_of_a_peer_is_made_printable_and_short() -> None:
    assert text({"error": b"no\x1b[2Jmore\n"}, "error") == "no [2Jmore "
    assert len(text({"error": b"e" * 10000}, "error")) == 4096


def test_an_alias_on_the_wire_is_refused() -> None:
    assert refuse_on_wire("/robot/pose") == "/robot/pose"
    for alias in ("/remote/hospital/robot/pose", "/remote", "/remote/"):
        with pytest.raises(ConnectionHeaderRefused, match="no name on the wire") as caught:
            refuse_on_wire(alias)
        assert "by the origin's name" in caught.value.hint


def test_a_foreign_caller_calls_itself_by_its_certified_name() -> None:
    peer = SITE.anchor.verify([SITE.leaf("/robot")], NOW)
    peer = replace(peer, name="/remote/hospital/robot", certified="/robot")
    check_caller({"callerid": b"/robot"}, peer)
    with pytest.raises(ConnectionHeaderRefused, match="certified as hospital:/robot calls itself /remote"):
        check_caller({"callerid": peer.name.encode()}, peer)
