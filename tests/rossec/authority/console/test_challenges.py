"""Challenges: used once, for their purpose, in time; a flood ends none."""

from functools import partial

import pytest

from ca.approvals.passkeys import Challenge, Purpose
from ca.errors import ApprovalRefused
from rossec.authority.console.access import CHALLENGE_LIFETIME, MAX_USED, LoginChallenges
from tests.support import refusal_texts

NOW = 1_800_000_000


def make(challenges: LoginChallenges, purpose: Purpose) -> Challenge:
    return challenges.make(purpose, "home", "http://localhost", "localhost", NOW)


def test_a_challenge_is_used_once_and_for_its_purpose() -> None:
    challenges = LoginChallenges()
    challenge = make(challenges, Purpose.LOGIN)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        challenges.open(Purpose.PASSKEY, challenge.id)
    assert challenges.open(Purpose.LOGIN, challenge.id) == challenge
    assert challenge.until == NOW + CHALLENGE_LIFETIME
    challenges.use(challenge)
    for again in (lambda: challenges.open(Purpose.LOGIN, challenge.id), partial(challenges.use, challenge)):
        with pytest.raises(ApprovalRefused, match="answered before"):
            again()


def test_a_challenge_ends() -> None:
    time = [0.0]
    challenges = LoginChallenges(lambda: time[0])
    challenge = make(challenges, Purpose.LOGIN)
    time[0] += CHALLENGE_LIFETIME
    with pytest.raises(ApprovalRefused, match="took too long"):
        challenges.open(Purpose.LOGIN, challenge.id)


@pytest.mark.parametrize("number", [b"", bytes(16), bytes(200), b"\xff" * 64])
def test_an_id_from_elsewhere_is_none(number: bytes) -> None:
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        LoginChallenges().open(Purpose.LOGIN, number)


def test_every_octet_of_an_id_counts() -> None:
    challenges = LoginChallenges()
    number = make(challenges, Purpose.LOGIN).id
    for place in range(len(number)):
        changed = bytes(octet ^ (at == place) for at, octet in enumerate(number))
        with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
            challenges.open(Purpose.LOGIN, changed)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        LoginChallenges().open(Purpose.LOGIN, number)  # of another process


@pytest.mark.attack("login-flood")
def test_those_who_ask_for_challenges_end_none() -> None:
    challenges = LoginChallenges()
    first = make(challenges, Purpose.LOGIN)
    for _ in range(10_000):
        make(challenges, Purpose.LOGIN)
    assert challenges.open(Purpose.LOGIN, first.id) == first
    assert len(challenges) == 0, "nothing is kept of what nobody answered"


def test_what_was_used_is_remembered_until_its_end_and_no_more_than_that() -> None:
    time = [0.0]
    challenges = LoginChallenges(lambda: time[0])
    made = [make(challenges, Purpose.LOGIN) for _ in range(MAX_USED + 1)]
    for each in made[:-1]:
        challenges.use(each)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        challenges.use(made[-1])
    time[0] += CHALLENGE_LIFETIME
    challenges.use(make(challenges, Purpose.LOGIN))
    assert len(challenges) == 1
