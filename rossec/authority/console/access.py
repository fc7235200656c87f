"""Who may look, and whose passkeys approve: one-time codes, challenges, logins, new passkeys.

All in memory. A challenge is kept nowhere until a passkey has answered it. Of a code only the
SHA-256 is kept; it is used once, for one purpose. A passkey that a new phone proposes waits until a
phone that is there already approves it (`approving`): both show the same digits, whose id comes from
here, so nobody can look for a passkey whose digits are those of another. Time is that of a clock that
cannot be set.
"""

import hashlib
import hmac
import secrets
import threading
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import Final, NamedTuple

from ca.approvals.passkeys import (
    Assertion,
    Challenge,
    Passkey,
    Purpose,
    Registration,
    base64url,
    register,
    verify,
)
from ca.encoding import Value, decode, encode
from ca.errors import ApprovalRefused
from rossec import clock
from rossec.authority.console import messages
from rossec.authority.console.messages import (
    CODE_LIFETIME,
    LoginChallenge,
    PhoneView,
    Proposal,
    check_page,
    to_value,
)
from rossec.authority.keyservice.work import AuthorityWork
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


class ConsoleAccess:
    """`audit`: writes a line. Raises `HintedError` if it cannot. `elapsed`: seconds of a clock that cannot
    be set.
    """

    def __init__(
        self, work: AuthorityWork, audit: Callable[[str], None], elapsed: clock.Seconds | None = None
    ) -> None:
        self.proposed = Proposals(elapsed)
        self._work = work
        self._audit = audit
        self._codes = Codes(elapsed)
        self._challenges = LoginChallenges(elapsed)
        self._counters: dict[bytes, int] = {}  # by credential id, of logins, as the times
        self._logins: dict[bytes, int] = {}

    def counter(self, passkey: bytes) -> int:
        # The counter of a passkey at its last login; 0: it has not logged in, or has none.
        return self._counters.get(passkey, 0)

    def last_used(self, passkey: bytes) -> int:
        # When a passkey last logged in, since the service began; 0: it has not.
        return self._logins.get(passkey, 0)

    def phone_code(self, caller: object) -> str:
        self._audit(f"makes a code for a phone, for {caller}")
        return self._codes.make(CodeUse.TERMINAL)

    def redeem(self, code: str) -> Value:
        self._codes.use(code, CodeUse.TERMINAL)
        self._audit("a code from the terminal was used at the console, to look")
        return None

    def login_challenge(self, origin: str) -> Value:
        with self._work.record() as store:
            found = [each for each in store.passkeys.active() if each.origin == origin]
        if not found:
            raise ApprovalRefused(
                f"no phone was registered at {origin[:80]!a}", "register one: rossec console phone"
            )
        challenge = self._make(Purpose.LOGIN, origin, found[0].rp_id)
        return _shown(challenge, tuple(each.id for each in found))

    def login(self, number: bytes, *assertion: bytes) -> Value:
        challenge = self._challenges.open(Purpose.LOGIN, number)
        signed = Assertion(*assertion)
        with self._work.record() as store:
            passkey = store.passkeys.get(signed.credential)
            last = max(self.counter(passkey.id), store.approvals.counter(passkey.id))
        counter = verify(signed, passkey, challenge.digest, last)
        self._challenges.use(challenge)
        self._audit(f"the phone {passkey.name!a} logged in at the console")
        self._counters[passkey.id] = counter
        self._logins[passkey.id] = self._work.now()
        return passkey.name

    def new_passkey(self, origin: str, rp_id: str) -> Value:
        check_page(origin, rp_id)
        with self._work.record() as store:
            found = store.passkeys.active()
        check_bound(found, origin, rp_id)
        challenge = self._make(Purpose.PASSKEY, origin, rp_id)
        return _shown(challenge, tuple(each.id for each in found))

    def add_passkey(self, number: bytes, code: str, name: str, *registration: bytes) -> Value:
        # The code is sent together with the passkey, and used up by either `redeem` or this: so what a
        # session that may only look knows adds no passkey.
        passkey = self._register(number, code, CodeUse.TERMINAL, name, registration)
        with self._work.record() as store, store.transaction():
            check_bound(store.passkeys.active(), passkey.origin, passkey.rp_id)
            store.passkeys.add(passkey)
            self._audit(f"adds the phone {name!a}, by a code from the terminal")
            # In the transaction: a code that is refused here adds nothing.
            self._codes.use(code, CodeUse.TERMINAL)
        return to_value(PhoneView(passkey.id, name, passkey.at, 0, "", ""))

    def phone_link(self, owner: str = "") -> Value:
        self._audit("makes a link at the console, for another phone")
        return self._codes.make(CodeUse.PHONE, owner)

    def propose_passkey(self, number: bytes, code: str, name: str, *registration: bytes) -> Value:
        passkey = self._register(number, code, CodeUse.PHONE, name, registration)
        proposal = self.proposed.add(passkey, passkey.at, self._codes.owner(code))
        self._codes.use(code, CodeUse.PHONE)
        self._audit(f"the phone {name!a} asks at the console to be added")
        return to_value(proposal)

    def proposals(self) -> Value:
        return to_value(self.proposed.all())

    def end_proposal(self, number: bytes) -> Value:
        self.proposed.get(number)
        self.proposed.drop(number)
        return None

    def _register(
        self, number: bytes, code: str, use: CodeUse, name: str, registration: tuple[bytes, ...]
    ) -> Passkey:
        self._codes.check(code, use)
        challenge = self._challenges.open(Purpose.PASSKEY, number)
        passkey = register(Registration(*registration), challenge, name, self._work.now())
        self._challenges.use(challenge)
        return passkey

    def _make(self, purpose: Purpose, origin: str, rp_id: str) -> Challenge:
        domain = self._work.home().domain
        return self._challenges.make(purpose, domain, origin, rp_id, self._work.now())


def check_bound(known: list[Passkey], origin: str, rp_id: str) -> None:
    # All passkeys are of one page: those of the first bind the others until every one was removed.
    for each in known:
        if (each.origin, each.rp_id) != (origin, rp_id):
            raise ApprovalRefused(
                f"the phones here belong to {each.origin}, not to {origin}",
                "open the console there; after rossec console --rename all register anew",
            )


def _shown(challenge: Challenge, credentials: tuple[bytes, ...]) -> Value:
    return to_value(
        LoginChallenge(challenge.id, challenge.digest, challenge.until, challenge.rp_id, credentials)
    )
