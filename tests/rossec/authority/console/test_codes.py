"""One-time codes: once, for one purpose, for two minutes."""

import base64
import hashlib

import pytest

from rossec.authority.console.access import MAX_CODES, MAX_FAILURES, PERIOD, Codes, CodeUse
from rossec.authority.console.messages import CODE_LIFETIME
from rossec.errors import PhoneCodeRefused

TERMINAL, PHONE = CodeUse.TERMINAL, CodeUse.PHONE


class Time:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def time() -> Time:
    return Time()


@pytest.fixture
def codes(time: Time) -> Codes:
    return Codes(time)


def test_a_code_is_used_once(codes: Codes) -> None:
    code = codes.make(TERMINAL)
    codes.check(code, TERMINAL)
    codes.check(code, TERMINAL)
    codes.use(code, TERMINAL)
    for refused in (codes.check, codes.use):
        with pytest.raises(PhoneCodeRefused, match="not valid") as caught:
            refused(code, TERMINAL)
        assert "rossec console phone" in caught.value.hint


def test_a_code_has_128_random_bits(time: Time) -> None:
    code = Codes(time, lambda size: b"\xff" * size).make(TERMINAL)
    assert base64.urlsafe_b64decode(code + "==") == b"\xff" * 16
    assert Codes().make(TERMINAL) != Codes().make(TERMINAL)


def test_a_code_is_not_kept(codes: Codes) -> None:
    code = codes.make(PHONE)
    kept = repr(vars(codes))
    assert code not in kept
    assert repr(hashlib.sha256(code.encode()).digest()) in kept


def test_a_code_is_for_one_purpose(codes: Codes) -> None:
    code = codes.make(PHONE)
    with pytest.raises(PhoneCodeRefused):
        codes.use(code, TERMINAL)
    codes.use(code, PHONE)


def test_a_code_ends(codes: Codes, time: Time) -> None:
    first = codes.make(TERMINAL)
    time.now += CODE_LIFETIME - 1
    codes.check(first, TERMINAL)
    time.now += 1
    with pytest.raises(PhoneCodeRefused):
        codes.use(first, TERMINAL)


def test_codes_are_bounded(codes: Codes) -> None:
    made = [codes.make(TERMINAL) for _ in range(MAX_CODES + 1)]
    codes.use(made[-1], TERMINAL)
    codes.use(made[1], TERMINAL)
    with pytest.raises(PhoneCodeRefused):
        codes.use(made[0], TERMINAL)


def test_after_wrong_ones_only_a_right_one_is_taken(codes: Codes, time: Time) -> None:
    for wrong in ("", "x", "\udcff", "é" * 100):
        with pytest.raises(PhoneCodeRefused, match="not valid"):
            codes.use(wrong, TERMINAL)
    time.now += 1
    right = codes.make(TERMINAL)
    with pytest.raises(PhoneCodeRefused, match="not valid"):
        codes.check("fifth", PHONE)
    with pytest.raises(PhoneCodeRefused, match="too many codes were wrong") as caught:
        codes.use("sixth", TERMINAL)
    assert caught.value.hint == "wait 60 seconds"
    codes.use(right, TERMINAL)
    with pytest.raises(PhoneCodeRefused, match="too many codes were wrong"):
        codes.use(right, TERMINAL)
    time.now += PERIOD
    with pytest.raises(PhoneCodeRefused, match="not valid"):
        codes.use(right, TERMINAL)


def test_wrong_ones_now_and_then_do_not_add_up(codes: Codes, time: Time) -> None:
    for _ in range(3 * MAX_FAILURES):
        with pytest.raises(PhoneCodeRefused, match="not valid"):
            codes.use("wrong", TERMINAL)
        time.now += PERIOD / (MAX_FAILURES - 1)
