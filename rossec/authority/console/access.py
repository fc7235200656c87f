"""Who may look, and whose passkeys approve: codes, logins, new passkeys.

A passkey that a new phone proposes is added when a phone that is there already approves it (`approving`).
"""

from collections.abc import Callable

from ca.approvals.passkeys import Assertion, Challenge, Passkey, Purpose, Registration, register, verify
from ca.encoding import Value
from ca.errors import ApprovalRefused
from rossec import clock
from rossec.authority.console.messages import LoginChallenge, PhoneView, check_page, to_value
from rossec.authority.console.phone_codes import Codes, CodeUse, LoginChallenges, Proposals
from rossec.authority.keyservice.work import AuthorityWork


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
