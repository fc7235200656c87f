"""What phones are let in by: challenges, one-time codes, and passkeys that wait for an approval.

All in memory. A challenge is kept nowhere until a passkey has answered it. Of a code only the
SHA-256 is kept; it is used once, for one purpose. A passkey that a new phone proposes waits until a
phone that is there already approves it: both show the same digits, whose id comes from here, so
nobody can look for a passkey whose digits are those of another. Time is that of a clock that cannot
be set.
"""

import hashlib
import hmac
import secrets
import threading
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import Final, NamedTuple

from ca.approvals.passkeys import Challenge, Passkey, Purpose, base64url
from ca.encoding import decode, encode
from ca.errors import ApprovalRefused
from rossec import clock
from rossec.authority.console import messages
from rossec.authority.console.messages import Proposal
from rossec.errors import KeyServiceRefused, PhoneCodeRefused
from rossec.peer_limits import SharedTable

Random = Callable[[int], bytes]
CHALLENGE_LIFETIME: Final = 300  # seconds
MAX_USED: Final = 1024  # by passkeys of this authority, within `CHALLENGE_LIFETIME`; then they wait
_MAC: Final = 32  # bytes


class LoginChallenges:
    # Anybody on the network can ask for one, so its id says what it is for and until when, under a key of
    # this process (HMAC-SHA-256, as the cookies of RFC 4987 3.6 and RFC 9147 5.1). Only those that were
    # used are kept.

    def __init__(self, elapsed: clock.Seconds | None = None, random: Random = secrets.token_bytes) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._key = secrets.token_bytes(32)
        self._lock = threading.Lock()
        self._used: dict[bytes, float] = {}  # until when, by their id

    def __len__(self) -> int:
        # How many are remembered: those that were used, and are not over.
        return len(self._used)

    def make(self, purpose: Purpose, domain: str, origin: str, rp_id: str, now: int) -> Challenge:
        until, end = now + CHALLENGE_LIFETIME, int((self._elapsed() + CHALLENGE_LIFETIME) * 1000)
        said = encode([str(purpose), self._random(16), domain, origin, rp_id, now, until, end])
        return Challenge(purpose, self._mac(said) + said, domain, origin, rp_id, now, until)

    def open(self, purpose: Purpose, number: bytes) -> Challenge:
        # The challenge with this id; it is not used up.
        mac, said = number[:_MAC], number[_MAC:]
        if not hmac.compare_digest(mac, self._mac(said)):
            raise _other()
        match decode(said):
            case [found, bytes(), str(domain), str(origin), str(rp_id), int(made), int(until), int(end)]:
                pass
            case _:
                raise _other()
        if found != purpose:  # a login must not add a passkey
            raise _other()
        with self._lock:
            if number in self._used or self._elapsed() * 1000 >= end:
                raise _other()
        return Challenge(purpose, number, domain, origin, rp_id, made, until)

    def use(self, challenge: Challenge) -> None:
        with self._lock:
            now = self._elapsed()
            # Only what was used is kept, so a flood of questions fills nothing (`login-flood`).
            self._used = {number: end for number, end in self._used.items() if now < end}
            if challenge.id in self._used or len(self._used) >= MAX_USED:
                raise _other()
            self._used[challenge.id] = now + CHALLENGE_LIFETIME

    def _mac(self, said: bytes) -> bytes:
        return hmac.digest(self._key, said, "sha256")


def _other() -> ApprovalRefused:
    return ApprovalRefused("this was answered before, or took too long", "open the page again")


CODE_LIFETIME: Final = 120.0  # seconds
MAX_FAILURES: Final = 5
PERIOD: Final = 60.0  # seconds in which failures count, and for which they lock
MAX_CODES: Final = 16  # outstanding, of one use
_SIZE: Final = 16  # bytes


class CodeUse(StrEnum):
    TERMINAL = "terminal"  # to look, or to add a passkey
    PHONE = "phone"  # to propose a passkey


class _Code(NamedTuple):
    digest: bytes
    end: float
    owner: str


class Codes:
    """The codes that were made and not used yet; threads may share it."""

    def __init__(self, elapsed: clock.Seconds | None = None, random: Random = secrets.token_bytes) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._lock = threading.Lock()  # guards what follows
        self._codes: dict[CodeUse, SharedTable[bytes, _Code]] = {
            use: SharedTable(MAX_CODES) for use in CodeUse
        }
        self._failures: deque[float] = deque(maxlen=MAX_FAILURES)
        self._locked_until = float("-inf")

    def make(self, use: CodeUse, owner: str = "") -> str:
        text = base64url(self._random(_SIZE))
        code = _Code(_digest(text), self._elapsed() + CODE_LIFETIME, owner)
        with self._lock:
            now = self._elapsed()
            for table in self._codes.values():
                table.drop(lambda each: now >= each.end)
            if self._codes[use].add(code.digest, code, owner, messages.rank(owner)) is None:
                raise KeyServiceRefused(f"{MAX_CODES} codes were made already", "use them, or wait")
        return text

    def owner(self, text: str) -> str:
        with self._lock:
            found = self._codes[CodeUse.PHONE].get(_digest(text))
        return "" if found is None else found.owner

    def check(self, text: str, use: CodeUse) -> None:
        with self._lock:
            self._find(text, use)

    def use(self, text: str, use: CodeUse) -> None:
        with self._lock:
            self._codes[use].pop(self._find(text, use).digest)

    def _find(self, text: str, use: CodeUse) -> _Code:
        now, given = self._elapsed(), _digest(text)
        known = [code for _, code in self._codes[use].items()]
        # All are compared, each in constant time: the answer tells nothing of how much was right.
        found = [code for code in known if hmac.compare_digest(code.digest, given)]
        # A code has 128 bits, so nobody guesses one: after `MAX_FAILURES` wrong ones those who send more
        # wait, but a right one is always taken. Else any stranger could keep people out by being wrong.
        if found and now < found[0].end:
            return found[0]
        if now < self._locked_until:
            raise PhoneCodeRefused(
                "too many codes were wrong", f"wait {self._locked_until - now:.0f} seconds"
            )
        self._failures.append(now)
        if len(self._failures) == MAX_FAILURES and now - self._failures[0] < PERIOD:
            self._locked_until = now + PERIOD
            self._failures.clear()
        raise PhoneCodeRefused(
            "this code is not valid, or not any more", "make a new one: rossec console phone"
        )


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode(errors="surrogatepass")).digest()


PROPOSAL_LIFETIME: Final = 300  # seconds
MAX_PROPOSALS: Final = 4
_LABEL: Final = b"rossec-proposal-v1"


class _Proposed(NamedTuple):
    passkey: Passkey
    shown: Proposal
    end: float


class Proposals:
    def __init__(self, elapsed: clock.Seconds | None = None, random: Random = secrets.token_bytes) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._lock = threading.Lock()
        self._proposed: SharedTable[bytes, _Proposed] = SharedTable(MAX_PROPOSALS)

    def add(self, passkey: Passkey, now: int, owner: str = "") -> Proposal:
        # Keep a passkey that was registered by a link of `owner`, and not approved.
        # Where there are too many, the oldest by a link of a looker makes room for one by a phone's.
        rank = messages.rank(owner)
        with self._lock:
            self._drop_old()
            waiting = [self._proposed.owner(number) for number, _ in self._proposed.items()]
            if len(waiting) >= MAX_PROPOSALS and all(each and each[1] >= rank for each in waiting):
                raise KeyServiceRefused(
                    f"{MAX_PROPOSALS} phones wait to be approved", "approve them, or wait"
                )
            number = self._random(16)
            shown = Proposal(number, passkey.name, digits_of(number, passkey), now + PROPOSAL_LIFETIME)
            proposed = _Proposed(passkey, shown, self._elapsed() + PROPOSAL_LIFETIME)
            self._proposed.add(number, proposed, owner, rank)
        return shown

    def all(self) -> tuple[Proposal, ...]:
        with self._lock:
            self._drop_old()
            return tuple(each.shown for _, each in self._proposed.items())

    def get(self, number: bytes) -> Passkey:
        with self._lock:
            self._drop_old()
            found = self._proposed.get(number)
        if found is None:
            raise ApprovalRefused(
                "this phone does not wait to be approved, or not any more",
                "make a new link, and open it on that phone",
            )
        return found.passkey

    def drop(self, number: bytes) -> None:
        with self._lock:
            self._proposed.pop(number)

    def _drop_old(self) -> None:
        now = self._elapsed()
        self._proposed.drop(lambda each: now >= each.end)


def digits_of(number: bytes, passkey: Passkey) -> str:
    told = b"".join((_LABEL, number, hashlib.sha256(passkey.id).digest(), passkey.cose_key))
    return f"{int.from_bytes(hashlib.sha256(told).digest()) % 1_000_000:06d}"
