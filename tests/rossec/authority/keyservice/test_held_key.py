"""The key is held for a time, by a clock that counts sleep; wrong passphrases take ever longer."""

import threading

import pytest

from ca.errors import PassphraseRefused
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner, Signer
from rossec import clock
from rossec.authority.keyservice import operations as module
from rossec.authority.keyservice.operations import MAX_DELAY, HeldKey
from rossec.errors import AuthorityLocked, KeyServiceRefused
from tests.support.pki import new_signer

SIGNER = new_signer()
RIGHT = "four random words"


class TimedKey:
    """A key whose passphrase is `RIGHT`, and its clock."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.key = HeldKey(self.load, lambda: self.now)

    def load(self, passphrase: str) -> Signer:
        if passphrase != RIGHT:
            raise PassphraseRefused("it does not open")
        return SIGNER


@pytest.fixture
def held() -> TimedKey:
    return TimedKey()


def test_it_signs_for_the_time_it_is_unlocked(held: TimedKey) -> None:
    assert held.key.remaining() is None
    with pytest.raises(AuthorityLocked, match="locked") as caught:
        held.key.sign(b"m")
    assert "rossec ca unlock" in caught.value.hint
    held.key.unlock(RIGHT, 60)
    assert held.key.remaining() == 60
    assert len(held.key.sign(b"m")) == 64
    held.now += 59.5
    assert held.key.remaining() == 1
    held.key.check()
    held.now += 0.5
    assert held.key.remaining() is None
    for use in (lambda: held.key.sign(b"m"), held.key.check):
        with pytest.raises(AuthorityLocked):
            use()


def test_it_is_dropped_once_when_its_time_is_over(held: TimedKey) -> None:
    assert not held.key.drop_if_over()
    held.key.unlock(RIGHT, 60)
    assert not held.key.drop_if_over()
    held.now += 8 * 3600  # the machine slept
    assert held.key.drop_if_over()
    assert not held.key.drop_if_over()
    held.now -= 8 * 3600
    assert held.key.remaining() is None


def test_zero_holds_it_until_it_is_locked(held: TimedKey) -> None:
    held.key.unlock(RIGHT, 0)
    held.now += 1e9
    assert held.key.remaining() == 0
    assert not held.key.drop_if_over()
    held.key.sign(b"m")
    assert held.key.lock()
    assert not held.key.lock()
    assert held.key.remaining() is None


def test_unlocking_again_begins_a_new_time(held: TimedKey) -> None:
    held.key.unlock(RIGHT, 60)
    held.key.unlock(RIGHT, 5)
    assert held.key.remaining() == 5


def test_each_wrong_passphrase_doubles_the_wait(held: TimedKey) -> None:
    for wait in (1, 2, 4, 8, 16, 32, MAX_DELAY, MAX_DELAY):
        with pytest.raises(PassphraseRefused):
            held.key.unlock("wrong", 60)
        held.now += wait - 0.1
        with pytest.raises(KeyServiceRefused, match="may be tried in"):
            held.key.unlock(RIGHT, 60)
        held.now += 0.1
    held.key.unlock(RIGHT, 60)
    with pytest.raises(PassphraseRefused):
        held.key.unlock("wrong", 60)
    assert held.key.remaining() == 60, "a wrong passphrase does not lock it"
    held.now += 1
    held.key.unlock(RIGHT, 60)


def test_two_passphrases_are_not_tried_at_the_same_time() -> None:
    begun, goes_on = threading.Event(), threading.Event()

    def load(_: str) -> Signer:
        begun.set()
        assert goes_on.wait(10)
        return SIGNER

    key = HeldKey(load)
    thread = threading.Thread(target=key.unlock, args=(RIGHT, 60))
    thread.start()
    assert begun.wait(10)
    assert not key.drop_if_over(), "what is asked meanwhile does not wait"
    with pytest.raises(KeyServiceRefused, match="being tried"):
        key.unlock(RIGHT, 60)
    goes_on.set()
    thread.join()
    assert key.remaining()


def test_a_token_is_logged_out_before_its_pin_is_tried_again(
    held: TimedKey, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a session open in the process a token would accept any PIN."""

    class Token(KeySigner):
        closed = False

        def close(self) -> None:
            self.closed = True

    monkeypatch.setattr(module, "TokenSigner", Token)
    token = Token(generate())
    key = HeldKey(lambda pin: token if pin == RIGHT else held.load(pin), lambda: held.now)
    key.unlock(RIGHT, 0)
    with pytest.raises(PassphraseRefused):
        key.unlock("wrong", 0)
    assert token.closed
    assert key.remaining() is None


def test_the_clock_counts_sleep_unless_another_is_given() -> None:
    assert clock.counter() is not None
    key = HeldKey(lambda _: SIGNER)
    key.unlock(RIGHT, 1)
    assert key.remaining() == 1
