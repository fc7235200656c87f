import hashlib

from hypothesis import given
from hypothesis import strategies as st

from ca.approvals.passkeys import Challenge, Purpose
from ca.approvals.statement import StatementKind
from ca.encoding import encode
from tests.support.approving import WHATS, state

challenges = st.builds(
    Challenge,
    st.sampled_from(Purpose),
    st.binary(min_size=16, max_size=16),
    *3 * [st.text(st.characters(exclude_categories=["Cs"]), max_size=20)],
    *2 * [st.integers(0, 1 << 40)],
)


@given(challenges, challenges)
def test_no_two_challenges_have_one_digest(first: Challenge, second: Challenge) -> None:
    assert (first.digest == second.digest) == (first == second)


def test_a_challenge_says_what_it_is_for() -> None:
    challenge = Challenge(Purpose.LOGIN, bytes(16), "home", "http://localhost", "localhost", 1, 2)
    fields = ["rossec-login-v1", bytes(16), "home", "http://localhost", "localhost", 1, 2]
    assert challenge.digest == hashlib.sha256(encode(fields)).digest()  # type: ignore[arg-type]
    other = challenge._replace(purpose=Purpose.PASSKEY)
    statements = {state(what).challenge for what in WHATS.values()}
    assert len({challenge.digest, other.digest} | statements) == 2 + len(StatementKind)
