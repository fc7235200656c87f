"""Challenges: taken once, for their purpose, in time; a flood ends no challenge of the other."""

import pytest

from ca.approvals.challenges import Challenge, Purpose
from ca.errors import OtherChallenge
from rossec.authority.console.challenges import LIFETIME, MAX_CHALLENGES, Challenges

NOW = 1_800_000_000


def make(challenges: Challenges, purpose: Purpose) -> Challenge:
    return challenges.make(purpose, "home", "http://localhost", "localhost", NOW)


def test_a_challenge_is_taken_once_and_for_its_purpose() -> None:
    challenges = Challenges()
    challenge = make(challenges, Purpose.LOGIN)
    with pytest.raises(OtherChallenge):
        challenges.take(Purpose.PASSKEY, challenge.id)
    assert challenges.take(Purpose.LOGIN, challenge.id) == challenge
    assert (challenge.until, len(challenge.id)) == (NOW + LIFETIME, 16)
    with pytest.raises(OtherChallenge, match="answered before"):
        challenges.take(Purpose.LOGIN, challenge.id)


def test_a_challenge_ends() -> None:
    time = [0.0]
    challenges = Challenges(lambda: time[0])
    challenge = make(challenges, Purpose.LOGIN)
    time[0] += LIFETIME
    with pytest.raises(OtherChallenge, match="took too long"):
        challenges.take(Purpose.LOGIN, challenge.id)


def test_challenges_are_bounded_for_each_purpose() -> None:
    challenges = Challenges()
    kept = make(challenges, Purpose.PASSKEY)
    made = [make(challenges, Purpose.LOGIN) for _ in range(MAX_CHALLENGES + 1)]
    assert challenges.take(Purpose.PASSKEY, kept.id)
    assert challenges.take(Purpose.LOGIN, made[1].id)
    with pytest.raises(OtherChallenge):
        challenges.take(Purpose.LOGIN, made[0].id)
