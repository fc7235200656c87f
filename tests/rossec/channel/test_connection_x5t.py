"""Certificates named by a hash, with a cache on both sides."""

import pytest

from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.errors import ChannelClosed, OwnCredentialUnknown, PeerCredentialUnknown
from tests.support.wire import STRANGER, alice, bob, peers, wire


def met() -> tuple[KnownCertificates, KnownCertificates]:
    """What Alice and Bob know after a first handshake by value."""
    left, right = KnownCertificates(), KnownCertificates()
    wire(alice(known=left), bob(known=right)).pump()
    return left, right


def test_the_second_handshake_names_certificates_by_their_hashes() -> None:
    left, right = met()
    w = wire(alice(known=left, request_x5t=True), bob(known=right)).pump()
    assert peers(w.left) == ["/bob"]
    assert peers(w.right) == ["/alice"]
    assert sum(map(len, w.left.sent + w.right.sent)) <= 300
    w.left.core.send_unit(b"x")
    assert w.pump().right.units == [b"x"]


def test_nothing_is_sent_before_a_named_certificate_is_accepted() -> None:
    left, right = met()
    w = wire(alice(known=left, request_x5t=True), bob(known=right))
    w.right.give(w.left.take())
    w.left.give(w.right.take())
    with pytest.raises(ChannelClosed):
        w.left.core.send_unit(b"early")
    assert w.left.core.seal_small(b"early") is None
    assert peers(w.pump().left) == ["/bob"]


def test_a_responder_without_the_certificate_answers_error_3() -> None:
    left, _ = met()
    w = wire(alice(known=left, request_x5t=True), bob(known=KnownCertificates())).pump()
    assert isinstance(w.right.error, PeerCredentialUnknown)
    assert isinstance(w.left.error, OwnCredentialUnknown)
    left.introduced.clear()
    assert peers(wire(alice(known=left), bob(known=KnownCertificates())).pump().right) == ["/alice"]


def test_an_initiator_without_the_certificate_answers_error_3() -> None:
    _, right = met()
    w = wire(alice(known=KnownCertificates(), request_x5t=True), bob(known=right)).pump()
    assert isinstance(w.left.error, PeerCredentialUnknown)
    assert isinstance(w.right.error, OwnCredentialUnknown)
    assert peers(w.left) == []


def test_a_responder_without_a_cache_gets_the_certificate() -> None:
    """Alice was introduced to it, but it answers by value: it may not know references at all."""
    left, _ = met()
    assert peers(wire(alice(known=left, request_x5t=True)).pump().right) == ["/alice"]


def test_only_verified_certificates_are_cached() -> None:
    known = KnownCertificates()
    wire(alice(credentials=STRANGER), bob(known=known)).pump()
    assert len(known) == 0
