"""What is renewed on an open connection: certificates and grants, and peers that know neither."""

import pytest

from ca.encoding import encode
from ca.errors import HintedError
from rossec.channel.edhoc.messages import RENEWALS_EAD, says_renewals
from rossec.channel.negotiation import (
    MOST_AT_ONCE,
    SECONDS_EACH,
    ConnectionRenewals,
    GrantsPresented,
    IdentityRenewed,
    PresentedRenewalRefused,
)
from rossec.channel.opening import WireProtocol
from rossec.channel.records import MAX_GRANTS, ChannelLimits, Frame, header
from rossec.errors import LimitExceeded, ProtocolViolation
from rossec.participant.access import MAX_PRESENTED
from tests.support.wire import (
    ALICE,
    BOB,
    DAY,
    DEFAULTS,
    NOT_AFTER,
    NOW,
    End,
    FakeIdentity,
    Wire,
    alice,
    bob,
    joined,
    node,
    renewed,
    renews,
    trust,
)

LASTING = ChannelLimits(seconds=1 << 40)


def both(limits: ChannelLimits = LASTING) -> Wire:
    return joined(left=alice(limits=limits, renews=renews), right=bob(limits=limits, renews=renews))


def renewals_of(end: End) -> list[object]:
    kinds = (IdentityRenewed, PresentedRenewalRefused, GrantsPresented)
    return [event for event in end.events if isinstance(event, kinds)]


def test_a_renewed_certificate_takes_the_place_of_the_first() -> None:
    w = both()
    w.left.core.present_identity(ALICE.chain)
    assert w.left.take() == b"", "the peer has it"
    w.left.core.present_identity(renewed(ALICE))
    w.pump()
    [event] = renewals_of(w.right)
    assert isinstance(event, IdentityRenewed)
    assert event.identity.not_after == NOT_AFTER + DAY
    assert w.right.core.deadline() == NOT_AFTER + DAY
    w.right.core.tick(NOT_AFTER)
    w.left.core.send_unit(b"on and on")
    assert w.pump().right.units == [b"on and on"]
    with pytest.raises(LimitExceeded, match="certificate has expired"):
        w.right.core.tick(NOT_AFTER + DAY)


def test_a_certificate_that_was_renewed_during_the_handshake_follows_it() -> None:
    left, right = alice(renews=renews), bob(renews=renews)
    for core, own in ((left, ALICE), (right, BOB)):
        core.present_identity(renewed(own))
    w = joined(left=left, right=right)
    for end in (w.left, w.right):
        assert [type(event) for event in renewals_of(end)] == [IdentityRenewed]


def test_a_chain_of_two_is_presented_whole() -> None:
    made = ConnectionRenewals(trust, renews, ALICE.chain[0], NOW)
    data = made.own((*renewed(ALICE), b"above"))
    assert data == encode({33: [*renewed(ALICE), b"above"]})
    assert made.identity(data, trust(ALICE.chain, NOW), NOW).not_after == NOT_AFTER + DAY


@pytest.mark.parametrize(
    "chain",
    [
        node("/carol").chain,
        (ALICE.chain[0][:65] + b"/carol",),
        (node("/carol").chain[0][:65] + b"/alice",),
        node("/stranger").chain,
        (b"no certificate",),
    ],
)
def test_any_other_certificate_is_refused_and_changes_nothing(chain: tuple[bytes, ...]) -> None:
    w = both()
    w.left.core.present_identity(chain)
    w.pump()
    assert [type(event) for event in renewals_of(w.right)] == [PresentedRenewalRefused]
    assert w.right.core.deadline() == NOT_AFTER
    with pytest.raises(LimitExceeded, match="certificate has expired"):
        w.right.core.tick(NOT_AFTER)


@pytest.mark.parametrize("data", [b"\xff", encode([1]), encode({34: [-15, bytes(8)]}), b""])
def test_malformed_certificates_are_refused(data: bytes) -> None:
    made = ConnectionRenewals(trust, renews, b"", NOW)
    with pytest.raises(HintedError):
        made.identity(data, trust(ALICE.chain, NOW), NOW)


def test_grants_belong_to_no_unit() -> None:
    """Not even in the middle of one, or where units are still short."""
    short = ChannelLimits(seconds=1 << 40, preauth_limit=100)
    w = both(short)
    w.right.core.raise_unit_limit()
    w.left.core.raise_unit_limit()
    records = w.left.core.seal_unit(bytes(600_000))
    w.right.give(bytes(next(records)))
    assert w.left.core.present_grants(b"g" * MAX_GRANTS)
    for record in records:
        w.right.give(bytes(record))
    assert w.right.units == [bytes(600_000)]
    assert renewals_of(w.right) == [GrantsPresented(b"g" * MAX_GRANTS)]
    w = both(short)
    assert w.left.core.present_grants(b"g" * MAX_GRANTS)
    w.step = 1000
    assert renewals_of(w.pump().right) == [GrantsPresented(b"g" * MAX_GRANTS)]


def test_grants_have_a_limit_on_both_sides() -> None:
    assert MAX_GRANTS == MAX_PRESENTED
    w = both()
    for data in (b"", bytes(MAX_GRANTS + 1)):
        with pytest.raises(LimitExceeded):
            w.left.core.present_grants(data)
    w.right.give(header(Frame.GRANTS, 0, MAX_GRANTS + 17))
    assert isinstance(w.right.error, ProtocolViolation)


def test_a_connection_for_calls_carries_certificates_and_no_grants() -> None:
    w = joined(left=alice(WireProtocol.HTTP, renews=renews), right=bob(renews=renews))
    assert not w.left.core.present_grants(b"g")
    w.left.core.present_identity(renewed(ALICE))
    assert [type(event) for event in renewals_of(w.pump().right)] == [IdentityRenewed]
    w.right.give(bytes(w.left.core._open_session().seal_renewal(Frame.GRANTS, b"g")))
    assert isinstance(w.right.error, ProtocolViolation)


def test_a_peer_that_presents_too_often_ends_the_connection() -> None:
    w = both()
    for _ in range(MOST_AT_ONCE):
        assert w.left.core.present_grants(b"g")
    assert w.pump().right.error is None
    w.left.core.present_grants(b"g")
    assert isinstance(w.pump().right.error, LimitExceeded)


def test_who_presents_seldom_may_do_so_for_ever() -> None:
    made = ConnectionRenewals(trust, renews, b"", NOW)
    for count in range(1000):
        made.charge(NOW + count * SECONDS_EACH)
    made.charge(NOW)  # a clock that is set back gives nothing
    for _ in range(MOST_AT_ONCE - 2):
        made.charge(NOW)
    with pytest.raises(LimitExceeded):
        made.charge(NOW)


@pytest.mark.parametrize("mine", [True, False])
def test_a_peer_that_takes_no_renewals_is_sent_none(mine: bool) -> None:
    """One of before, which ignores the label and ends the connection at a frame of this type."""
    known = {"renews": renews}
    w = joined(left=alice(**(known if mine else {})), right=bob(**({} if mine else known)))  # type: ignore[arg-type]
    for end, own in ((w.left, ALICE), (w.right, BOB)):
        assert not end.core.takes_renewals
        assert not end.core.present_grants(b"g")
        end.core.present_identity(renewed(own))
        assert end.take() == b""
    w.right.give(header(Frame.GRANTS, 0, 40) + bytes(40))
    assert isinstance(w.right.error, ProtocolViolation)


def test_the_label_is_found_among_others() -> None:
    assert says_renewals(RENEWALS_EAD)
    assert says_renewals(encode(7) + encode(b"value") + RENEWALS_EAD)
    assert not says_renewals(b"")
    assert not says_renewals(encode(7) + encode(RENEWALS_EAD))


def test_nothing_is_presented_after_the_end() -> None:
    w = both()
    w.left.core.close()
    w.pump()
    assert not w.left.core.present_grants(b"g")
    w.left.core.present_identity(renewed(ALICE))
    assert w.left.take() == b""
    assert DEFAULTS.unit > MAX_GRANTS
    assert isinstance(trust(renewed(ALICE, 2), NOW), FakeIdentity)
