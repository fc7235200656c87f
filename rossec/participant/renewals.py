"""Renewal of a node's grants and of its identity, and the proofs of a revocation tree, requested from the
master.

Call `renew` and `prove` about every second, and `renew` before registering on a new connection: a node that
was off for long holds grants that have expired but may still be renewed. `ca.certificates` has the rules for
identities.
"""

import logging
from collections.abc import Awaitable, Callable
from typing import Final, Protocol

from ca.certificates import Identity, renew_at, retry_delay, sign_renewal
from ca.errors import CAError, HintedError, RevocationRefused
from ca.revocation.trust_status import Revocations
from ca.svid import build_request
from grants.errors import GrantError
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.home import NodeHome, ended
from rossec.participant.access import HeldGrant, MembershipAccess
from rossec.peer_limits import printable
from rossec.ros.names import RENEW_IDENTITY

RENEW_GRANTS: Final = "rossec.renewGrants"
MAX_GRANTS_PER_CALL: Final = 16  # grants in one call: the limit of the master
GRANT_RETRY: Final = 60  # seconds at most until a grant that was not renewed is requested again
_TRIES: Final = 4  # requests at least in the rest of its lifetime
IDENTITY_METHOD: Final = RENEW_IDENTITY
IDENTITY_RETRY: Final = 600  # seconds at most after a refusal
FIRST_PAUSE: Final = 5  # seconds after the first request that has no answer yet; then doubled up to
LONGEST_PAUSE: Final = 60
WARN_EVERY: Final = 3600  # seconds at most between two warnings
_PENDING: Final = 0  # ROS's code: nothing was wrong with the call
REVOCATION_PROOFS: Final = "rossec.revocationProofs"
MAX_PROOFS_PER_CALL: Final = 64  # entries in one call: the limit of the master

_log = logging.getLogger("rossec.node")


class Renewals:
    """Selects the grants of one node that are due, and takes the renewed ones."""

    def __init__(self, access: MembershipAccess) -> None:
        self._access = access
        self._retry_at: dict[bytes, int] = {}
        self._epoch = access.epoch
        self._outdated: set[bytes] = set()

    def due(self, now: int) -> list[HeldGrant]:
        """Grants to be renewed now, the first to expire first; a refused one is due later. In a new epoch of
        the revocation list sequence numbers restart: earlier tickets are invalid."""
        began = self._access.epoch > self._epoch
        self._epoch = self._access.epoch
        if began:
            self._retry_at.clear()
            self._outdated = {held.token for held in self._access.held_grants() if held.grant.via}
        due = [
            held
            for held in self._access.held_grants()
            if (due_at(held) <= now or held.token in self._outdated)
            and now < held.grant.cap
            and held.grant.expires < held.grant.cap
            and self._retry_at.get(held.grant.id, 0) <= now
        ]
        chosen = sorted(due, key=lambda held: held.grant.expires)[:MAX_GRANTS_PER_CALL]
        for held in chosen:
            left = held.grant.expires - now
            pause = min(GRANT_RETRY, max(1, left // _TRIES)) if left > 0 else GRANT_RETRY
            self._retry_at[held.grant.id] = now + pause
        return chosen

    def take(self, requested: list[HeldGrant], answer: object, now: int) -> int:
        if not isinstance(answer, list) or len(answer) != len(requested):
            raise AnswerMalformed("the master's answer has a different number of grants than requested")
        return sum(self._hold(held, token, now) for held, token in zip(requested, answer, strict=True))

    def _hold(self, held: HeldGrant, token: object, now: int) -> bool:
        if not isinstance(token, bytes) or not token:
            return False
        try:
            self._access.hold_renewed(token, now)
        except GrantError as error:
            _log.warning("a grant renewed by the master is invalid: %s", printable(error))
            return False
        self._retry_at.pop(held.grant.id, None)  # only a refused grant has to wait
        return True


class MasterCall(Protocol):
    def __call__(self, method: str, *params: object) -> Awaitable[object]: ...


async def renew(call: MasterCall, renewals: Renewals, now: int) -> int:
    due = renewals.due(now)
    if not due:
        return 0
    return renewals.take(due, await call(RENEW_GRANTS, [held.original for held in due]), now)


def due_at(held: HeldGrant) -> int:
    """At about two thirds of its lifetime, spread (by the grant's random id) so that nodes do not all renew
    at once."""
    lifetime = held.grant.expires - held.since
    return held.since + lifetime * (560 + held.grant.id[0] * 200 // 255) // 1000


class IdentityRenewal:
    """The renewals of one node's identity, for as long as it runs, before it expires.

    The key stays, as grants are bound to it: there is one file to replace, which is done in one step. The new
    certificate is presented on open connections, and used for new ones. The same request is repeated until it
    is answered: the signer signs each request once, and always answers it with the same certificate. A
    certificate that somebody installs is used as well, also after the own one has ended: no master answers by
    then.
    """

    def __init__(self, home: NodeHome, credentials: LiveCredentials, now: int) -> None:
        self._home = home
        self._credentials = credentials
        self._identity = home.identity(now)
        self._version = self._file_version()
        self._csr = b""
        self._retry_at = self._warn_at = 0
        self._pause = FIRST_PAUSE
        self._elapsed = clock.counter()
        self._began = now, self._elapsed()

    def request(self, now: int) -> bytes | None:
        """The request to send now, if the identity is due; not again before it is worthwhile."""
        held = self._identity
        due = renew_at(held.not_before, held.not_after)
        if self._retry_at > now + IDENTITY_RETRY:  # by a clock that was ahead
            self._retry_at = self._warn_at = 0
        if now < max(due, self._retry_at):
            return None
        self._retry_at = now + retry_delay(held.not_before, held.not_after, IDENTITY_RETRY)
        if self.take_installed(now):
            return None
        own = self._credentials.current
        self._csr = self._csr or build_request(own.signer, held.domain, held.name)
        return sign_renewal(own.signer, own.chain, self._csr, now)

    def take_installed(self, now: int) -> bool:
        """Use a newer certificate that was installed meanwhile; returns whether there is one."""
        version = self._file_version()
        if version == self._version:
            return False
        held = self._identity
        try:
            found = self._home.identity(now)
        except (HintedError, OSError):  # it has expired, or the files are being changed
            return False
        self._version = version
        if found.thumbprint != held.thumbprint or found.not_after <= held.not_after:
            return False
        self._use(found)
        return True

    def take(self, bundle: object, now: int) -> None:
        if not isinstance(bundle, bytes):
            raise AnswerMalformed("an identity that is not bytes")
        self._use(self._home.install(bundle, now))
        self._version = self._file_version()

    def refused(self, error: AnswerRefused, now: int) -> None:
        """Say why there is no new identity; where it is only not there yet, ask again soon."""
        held, text = self._identity, printable(error)
        if error.code != _PENDING:
            _log.warning("the identity is not renewed: %s", text)
            return
        longest = min(self._pause, IDENTITY_RETRY)
        self._retry_at = now + retry_delay(held.not_before, held.not_after, longest)
        is_first, self._pause = self._pause == FIRST_PAUSE, min(2 * self._pause, LONGEST_PAUSE)
        level = logging.WARNING if now >= self._warn_at and not is_first else logging.INFO
        left = clock.format_duration(max(0, held.not_after - now))
        what = f"the identity ends in {left} and is not renewed yet"
        _log.log(level, "%s: %s: %s", held.name, what, text)
        if level == logging.WARNING:
            self._warn_at = now + retry_delay(held.not_before, held.not_after, WARN_EVERY)

    def ended(self, now: int) -> str:
        """What is to be said when the identity is over: no peer takes it any more; else empty."""
        if now <= self._identity.not_after:
            return ""
        began, counted = self._began
        passed = began + int(self._elapsed() - counted)  # whatever the clock was set to meanwhile
        chain, anchor = self._credentials.current.chain, self._home.anchor()
        error = ended(self._identity.name, chain, anchor, now, passed)
        return f"{error} ({error.hint})"

    def _use(self, identity: Identity) -> None:
        self._identity = identity
        self._credentials.current = self._home.credentials()
        self._csr, self._retry_at, self._warn_at, self._pause = b"", 0, 0, FIRST_PAUSE
        _log.info("%s: the identity was renewed", identity.name)

    def _file_version(self) -> tuple[int, int, int]:
        try:
            found = (self._home.path / "node.pem").stat()
        except OSError:
            return 0, 0, 0
        # The inode, too: files are replaced in one step, and two may have one size and time.
        return found.st_ino, found.st_mtime_ns, found.st_size


async def renew_identity(call: MasterCall, renewal: IdentityRenewal, now: int) -> bool:
    request = renewal.request(now)
    if request is None:
        return False
    try:
        renewal.take(await call(IDENTITY_METHOD, request), now)
    except AnswerRefused as error:
        renewal.refused(error, now)
        return False
    except CAError as error:
        _log.warning("the identity is not renewed: %s", printable(error))
        return False
    return True


async def prove(call: MasterCall, held: MembershipAccess | Revocations) -> int:
    wanted = held.unproved[:MAX_PROOFS_PER_CALL]
    return take(held.add_proof, wanted, await call(REVOCATION_PROOFS, wanted)) if wanted else 0


def take(add_proof: Callable[[bytes, bytes], None], wanted: list[bytes], answer: object) -> int:
    """Take the proofs in `answer`, one for each entry in `wanted`, or none at all."""
    if not isinstance(answer, list) or len(answer) not in {0, len(wanted)}:
        raise AnswerMalformed("the master's answer has a different number of proofs than requested")
    taken = 0
    for entry, proof in zip(wanted, answer, strict=False):
        try:
            add_proof(entry, proof if isinstance(proof, bytes) else b"")
            taken += 1
        except RevocationRefused as error:
            _log.warning("the master's proof for %s is invalid: %s", entry.hex(), error)
    return taken
