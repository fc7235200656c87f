"""Passkeys that wait to be approved: few, for five minutes, with digits of their own."""

import pytest

from ca.approvals.passkeys import Passkey
from ca.errors import ApprovalRefused
from rossec.authority.console.access import MAX_PROPOSALS, PROPOSAL_LIFETIME, Proposals, digits_of
from rossec.errors import KeyServiceRefused

NOW = 1_800_000_000


def passkey(name: str) -> Passkey:
    return Passkey(name.encode(), name, b"key", b"", "localhost", "http://localhost", b"", NOW)


def test_a_proposal_waits_until_it_is_dropped_or_over() -> None:
    time = [0.0]
    proposals = Proposals(lambda: time[0])
    first = proposals.add(passkey("Ann's"), NOW)
    time[0] = 10
    second = proposals.add(passkey("Ben's"), NOW + 10)
    assert proposals.all() == (first, second)
    assert (first.expires, first.name, len(first.digits)) == (NOW + PROPOSAL_LIFETIME, "Ann's", 6)
    assert proposals.get(first.id).name == "Ann's"
    proposals.drop(first.id)
    proposals.drop(first.id)
    time[0] += PROPOSAL_LIFETIME - 1
    assert proposals.all() == (second,)
    time[0] += 1
    assert proposals.all() == ()
    for gone in (first, second):
        with pytest.raises(ApprovalRefused, match="does not wait"):
            proposals.get(gone.id)


def test_proposals_are_bounded() -> None:
    time = [0.0]
    proposals = Proposals(lambda: time[0])
    for number in range(MAX_PROPOSALS):
        proposals.add(passkey(f"{number}"), NOW)
    with pytest.raises(KeyServiceRefused, match="wait to be approved"):
        proposals.add(passkey("one more"), NOW)
    time[0] += PROPOSAL_LIFETIME
    assert proposals.add(passkey("one more"), NOW)


def test_digits_of_differ_with_everything_they_are_made_of() -> None:
    base = passkey("Ann's")
    found = {
        digits_of(b"1", base),
        digits_of(b"2", base),
        digits_of(b"1", base._replace(id=b"other")),
        digits_of(b"1", base._replace(cose_key=b"other")),
    }
    assert len(found) == 4
    assert digits_of(b"1", base) == digits_of(b"1", base._replace(name="Eve's"))
