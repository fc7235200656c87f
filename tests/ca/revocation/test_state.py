import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from ca.errors import RevocationRefused, RevocationsStale, Revoked
from ca.revocation.lists import MAX_AGE, RevocationList, sign_list
from ca.revocation.trust_status import SKEW, Revocations
from tests.ca.revocation.signed_lists import KEY, LIFE, SIGNER, A, B, fresh, never, signed, stamp, twisted
from tests.support.pki import NOW, new_signer


def test_a_fresh_list_lets_others_pass() -> None:
    state = fresh(A, KEY)
    state.check(B, NOW)
    for entry in (A, KEY):
        with pytest.raises(Revoked, match=f"{entry.hex()} is revoked") as caught:
            state.check(entry, NOW)
        assert caught.value.hint


def test_nothing_known_means_no() -> None:
    state = Revocations(SIGNER.public_key)
    assert (state.fresh_until, state.entries, state.data, state.current) == (0, frozenset(), b"", None)
    with pytest.raises(RevocationsStale, match="no revocation list was received yet") as caught:
        state.check(A, NOW)
    assert "master" in caught.value.hint


def test_a_list_never_confirmed_means_no() -> None:
    state = Revocations(SIGNER.public_key)
    state.update(signed(1, A), NOW)
    assert state.fresh_until == 0
    with pytest.raises(RevocationsStale, match="is not confirmed by the master"):
        state.check(B, NOW)
    with pytest.raises(Revoked):
        state.check(A, NOW)


def test_only_grants_and_keys_can_be_asked_for() -> None:
    with pytest.raises(RevocationRefused, match="an entry is a grant id"):
        fresh().check(b"", NOW)


def test_a_confirmation_runs_out() -> None:
    state = fresh(A)
    assert state.fresh_until == NOW + MAX_AGE
    state.check(B, NOW + MAX_AGE)
    with pytest.raises(RevocationsStale, match="the last confirmation expired 1 s ago"):
        state.check(B, NOW + MAX_AGE + 1)


def test_a_list_expires() -> None:
    state = Revocations(SIGNER.public_key)
    data = signed(1, A)
    end = NOW + LIFE
    state.update(data, end)
    state.confirm(stamp(1, data, issued=end - 1), end - 1)
    assert state.fresh_until == end - 1
    state.check(B, end - 1)
    with pytest.raises(RevocationsStale, match="the revocation list expired 0 s ago") as caught:
        state.check(B, end)
    assert "sign a new one" in caught.value.hint


def test_an_expired_list_still_revokes() -> None:
    state = Revocations(SIGNER.public_key)
    assert state.update(signed(1, A), NOW + 2 * LIFE) == {A}
    with pytest.raises(Revoked):
        state.check(A, NOW + 2 * LIFE)
    with pytest.raises(RevocationsStale, match="expired 86400 s ago"):
        state.check(B, NOW + 2 * LIFE)


def test_a_clock_set_back_means_no() -> None:
    state = fresh()
    state.check(B, NOW - SKEW)
    with pytest.raises(RevocationsStale, match="the clock is behind the revocation list"):
        state.check(B, NOW - SKEW - 1)


def test_update_returns_the_added_entries() -> None:
    state = fresh(A)
    assert state.update(signed(2, A, B), NOW) == {B}
    assert state.update(signed(3, B), NOW) == frozenset()
    assert state.entries == {B}
    assert state.floor == (1, 3)


def test_a_new_list_needs_a_new_confirmation() -> None:
    state = fresh()
    state.update(signed(2), NOW)
    with pytest.raises(RevocationsStale, match="not confirmed"):
        state.check(B, NOW)


def test_the_same_list_again_changes_nothing() -> None:
    state = fresh(A)
    assert state.update(state.data, NOW, persist=never) == frozenset()
    state.check(B, NOW)


def test_the_same_list_with_a_twisted_signature() -> None:
    state = fresh(A)
    other = twisted(state.data)
    assert other != state.data
    assert state.update(other, NOW) == frozenset()
    state.confirm(stamp(1, other), NOW)
    state.check(B, NOW)


def test_an_older_list_is_refused() -> None:
    state = fresh()
    state.update(signed(5, A), NOW)
    with pytest.raises(RevocationRefused, match=r"revocation list 1\.4 is older than 1\.5") as caught:
        state.update(signed(4), NOW)
    assert "replayed" in caught.value.hint
    assert state.entries == {A}


def test_an_older_list_is_refused_after_a_restart() -> None:
    state = Revocations(SIGNER.public_key, floor=(2, 5))
    for old in (signed(4, epoch=2), signed(99, epoch=1)):
        with pytest.raises(RevocationRefused, match="is older than"):
            state.update(old, NOW)
    state.update(signed(5, epoch=2), NOW)


def test_a_new_epoch_begins_anew() -> None:
    state = Revocations(SIGNER.public_key, floor=(1, 99))
    state.update(signed(1, epoch=2), NOW)
    assert state.floor == (2, 1)


def test_two_lists_under_one_number() -> None:
    state = fresh(A)
    with pytest.raises(RevocationRefused, match=r"two different revocation lists 1\.1") as caught:
        state.update(signed(1), NOW)
    assert "new epoch" in caught.value.hint
    assert state.entries == {A}


def test_persisted_before_it_takes_effect() -> None:
    state = fresh()
    seen: list[tuple[bytes, tuple[int, int]]] = []
    data = signed(2, A)
    state.update(data, NOW, persist=lambda saved: seen.append((saved, state.floor)))
    assert seen == [(data, (1, 1))]
    assert state.floor == (1, 2)


def test_a_full_disk_changes_nothing() -> None:
    state = fresh()

    def full(_: bytes) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        state.update(signed(2, A), NOW, persist=full)
    assert (state.floor, state.entries) == ((1, 1), frozenset())
    state.check(A, NOW)


def test_foreign_lists_are_not_persisted() -> None:
    other = sign_list(new_signer(), RevocationList(1, 2, NOW, NOW + 1, frozenset()))
    with pytest.raises(RevocationRefused, match="does not verify"):
        fresh().update(other, NOW, persist=never)


def test_confirmations_that_do_not_fit() -> None:
    state = Revocations(SIGNER.public_key)
    data = signed(1, A)
    with pytest.raises(RevocationRefused, match="a timestamp came before any revocation list"):
        state.confirm(stamp(1, data), NOW)
    state.update(data, NOW)
    for bad in (stamp(2, data), stamp(0, data), stamp(1, data + b"\0"), stamp(1, b"")):
        with pytest.raises(RevocationRefused, match="is for another list than the current number 1"):
            state.confirm(bad, NOW)
    with pytest.raises(RevocationRefused, match="the timestamp is from the future"):
        state.confirm(stamp(1, data, issued=NOW + SKEW + 1), NOW)
    with pytest.raises(RevocationRefused, match="the timestamp is too old"):
        state.confirm(stamp(1, data, issued=NOW - 31), NOW)
    with pytest.raises(RevocationRefused, match="claims to be valid for too long"):
        state.confirm(stamp(1, data, max_age=31), NOW)
    assert state.fresh_until == 0


def test_confirmations_at_the_border() -> None:
    state = fresh()
    state.confirm(stamp(1, state.data, issued=NOW + SKEW), NOW)
    assert state.fresh_until == NOW + SKEW + MAX_AGE
    state = fresh()
    state.confirm(stamp(1, state.data, issued=NOW), NOW + MAX_AGE)
    state.check(B, NOW + MAX_AGE)


def test_a_replayed_confirmation_neither_helps_nor_hurts() -> None:
    state = fresh()
    state.confirm(stamp(1, state.data, issued=NOW + 20), NOW + 20)
    state.confirm(stamp(1, state.data, issued=NOW), NOW + 21)
    assert state.fresh_until == NOW + 50


def test_a_corrected_clock_heals() -> None:
    state = fresh()
    state.confirm(stamp(1, state.data, issued=NOW + 3600), NOW + 3600)
    with pytest.raises(RevocationsStale, match="the clock is behind"):
        state.check(B, NOW + 10)
    state.confirm(stamp(1, state.data, issued=NOW + 10), NOW + 10)
    state.check(B, NOW + 10)


class Moving(RuleBasedStateMachine):
    """Whatever arrives in whatever order: what is revoked stays refused, time does not go back."""

    def __init__(self) -> None:
        super().__init__()
        self.state = Revocations(SIGNER.public_key)
        self.lists = {seq: signed(seq, *([A] if seq >= 3 else [])) for seq in range(6)}
        self.highest = -1
        self.now = NOW

    @rule(seq=st.integers(0, 5))
    def deliver(self, seq: int) -> None:
        try:
            self.state.update(self.lists[seq], self.now)
        except RevocationRefused:
            assert seq < self.highest
        else:
            assert seq >= self.highest
            self.highest = seq

    @precondition(lambda self: self.highest >= 0)
    @rule(seq=st.integers(0, 5), age=st.integers(-10, 40))
    def vouch(self, seq: int, age: int) -> None:
        try:
            self.state.confirm(stamp(seq, self.lists[seq], self.now - age), self.now)
        except RevocationRefused:
            assert seq != self.highest or not -SKEW <= age <= MAX_AGE

    @rule(step=st.integers(0, 40))
    def wait(self, step: int) -> None:
        self.now += step

    @invariant()
    def revoked_stays_refused(self) -> None:
        if self.highest >= 3:
            with pytest.raises(Revoked):
                self.state.check(A, self.now)

    @invariant()
    def fresh_until_tells_the_truth(self) -> None:
        try:
            self.state.check(B, self.now)
        except RevocationsStale:
            assert self.now > self.state.fresh_until
        else:
            assert self.now <= self.state.fresh_until


TestMoving = Moving.TestCase
TestMoving.settings = settings(max_examples=30, stateful_step_count=20)


def test_an_expired_confirmation_admits_no_peer_and_closes_no_connection() -> None:
    state = fresh(A)
    state.expire_confirmation(NOW + 3)
    assert state.fresh_until == NOW + 3
    with pytest.raises(RevocationsStale, match="not confirmed"):
        state.check(B, NOW)
    state.expire_confirmation(NOW + 9)
    assert state.fresh_until == NOW + 3, "doubt does not make it last"
    state.confirm(stamp(1, state.data), NOW)
    state.check(B, NOW)
    state.expire_confirmation()
    assert state.fresh_until == 0


def test_a_confirmation_may_be_as_old_as_the_reader_says() -> None:
    data = signed(1, A)
    state = Revocations(SIGNER.public_key, fresh=3600)
    state.update(data, NOW)
    state.confirm(stamp(1, data, issued=NOW - 3600), NOW)
    assert state.fresh_until == NOW
    state.fresh = 7200
    state.check(B, NOW + 3600)
    with pytest.raises(RevocationsStale):
        state.check(B, NOW + 3601)
    state.fresh = None
    with pytest.raises(RevocationsStale):
        state.check(B, NOW)
    assert state.is_proved(B)
