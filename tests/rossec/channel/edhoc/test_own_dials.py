"""A node may call itself where it means to; the same messages anywhere else are a reflection."""

import dataclasses
import gc

from rossec.channel.edhoc.credentials import KnownCertificates, SelfConnections
from rossec.channel.negotiation import Authenticated
from rossec.errors import IdentityRefused, PeerRefused
from tests.support.wire import ALICE, BOB, FakeIdentity, Wire, alice, bob, receive, wire


def own(dials: SelfConnections, answering: SelfConnections | None) -> Wire:
    """A dial of alice's, meant for alice, with who answers."""
    return wire(alice(self_connections=dials), bob(credentials=ALICE, self_connections=answering)).pump()


def test_a_node_reaches_itself() -> None:
    dials = SelfConnections()
    w = own(dials, dials)
    assert (w.left.error, w.right.error) == (None, None)
    for end in (w.left, w.right):
        (event,) = end.events
        assert isinstance(event, Authenticated)
        assert event.identity.name == "/alice"
    w.left.core.send_unit(b"to myself")
    w.pump()
    assert w.right.units == [b"to myself"]
    w.right.core.send_unit(b"from myself")
    w.pump()
    assert w.left.units == [b"from myself"]


def test_nothing_of_a_dial_is_kept() -> None:
    dials = SelfConnections()
    caller = alice(self_connections=dials)
    assert len(dials) == 1
    del caller  # before there was an answer
    gc.collect()
    assert len(dials) == 0
    w = own(dials, dials)  # open: it was answered, and nobody asks for it any more
    assert w.left.error is None
    assert len(dials) == 0


def test_a_dial_for_another_node_is_refused_by_this_one() -> None:
    dials = SelfConnections()
    w = wire(alice(), bob(credentials=ALICE, self_connections=dials)).pump()
    assert isinstance(w.left.error, IdentityRefused)
    assert "own certificate" in str(w.left.error)
    assert "redirects" in w.left.error.hint


def test_another_process_with_the_same_key_is_not_this_one() -> None:
    w = own(SelfConnections(), SelfConnections())
    assert isinstance(w.left.error, IdentityRefused)
    assert w.right.events == []


def test_the_responder_checks_for_itself() -> None:
    """Another holder of the key, whatever it accepts, is refused by the node itself."""
    careless = dataclasses.replace(ALICE, shared=True)
    w = wire(alice(credentials=careless), bob(credentials=ALICE, self_connections=SelfConnections())).pump()
    assert isinstance(w.right.error, IdentityRefused)
    assert isinstance(w.left.error, PeerRefused)


def test_no_other_node_is_accepted_at_the_own_address() -> None:
    dials = SelfConnections()
    w = wire(alice(self_connections=dials), bob(self_connections=dials)).pump()
    assert isinstance(w.left.error, IdentityRefused)
    assert str(w.left.error) == "another node answers at this node's own address"
    assert "ROS_IP" in w.left.error.hint


def test_a_repeated_message_1_changes_nothing() -> None:
    """An attacker forwards the dial twice: the first answer alone belongs to it."""
    dials = SelfConnections()
    caller = alice(self_connections=dials)
    flight = bytes(caller.data_to_send())
    first, second = (
        bob(credentials=ALICE, self_connections=dials),
        bob(credentials=ALICE, self_connections=dials),
    )
    assert second._negotiation is not None
    edhoc = second._negotiation._edhoc
    edhoc.config = dataclasses.replace(edhoc.config, random=lambda size: b"\5" * size)
    receive(first, flight, 0)
    receive(second, flight, 0)
    answer = bytes(second.data_to_send())
    assert bytes(first.data_to_send()) != answer
    w = wire(caller, second)
    w.left.give(answer)
    assert isinstance(w.left.error, IdentityRefused)


def test_a_certificate_that_was_renewed_meanwhile_is_the_own_one_still() -> None:
    """A redirect held back until then: another certificate, the same key."""
    renewed = dataclasses.replace(ALICE, chain=(ALICE.chain[0] + b"2",))
    w = wire(alice(), bob(credentials=renewed)).pump()
    assert isinstance(w.left.error, IdentityRefused)


def test_a_retry_for_another_suite_and_a_reference_reach_it_as_well() -> None:
    dials, known = SelfConnections(), KnownCertificates()
    caller = alice(self_connections=dials, suites=(-24, 6))
    w = wire(caller, bob(credentials=ALICE, self_connections=dials)).pump()
    assert (w.left.error, w.right.error) == (None, None)
    for request_x5t in (False, True):
        caller = alice(self_connections=dials, known=known, request_x5t=request_x5t)
        w = wire(caller, bob(credentials=ALICE, self_connections=dials, known=known)).pump()
        assert (w.left.error, w.right.error) == (None, None)


def test_a_node_with_own_dials_still_reaches_others() -> None:
    w = wire(alice(), bob(credentials=BOB, self_connections=SelfConnections())).pump()
    met = [event for event in w.right.events if isinstance(event, Authenticated)]
    assert [event.identity.name for event in met] == ["/alice"]
    assert isinstance(met[0].identity, FakeIdentity)
