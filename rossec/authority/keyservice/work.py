"""What the service does with the key by itself: joins, and with `--apply` what the policy gives.

Called in one thread of its own, in which the record is opened for each task: commands are answered
meanwhile. Signatures are audited like those of commands, with the purpose. Deposits and lists are
passed to the master by the network face; what it does not take is recorded and signed all the same,
and the next round tries again.
"""

import contextlib
import logging
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Final

from ca.enrollment.join_claim import JoinClaim
from ca.enrollment.join_messages import Issued, Refused, write
from ca.enrollment.join_request import JoinRequest
from ca.errors import HintedError, StoreError
from grants.errors import PolicyRefused
from rossec import clock
from rossec.authority import joining, policyfile, renewals
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.operations import KeyOperations, OwnSigner
from rossec.authority.master_call import MasterCall
from rossec.authority.service import AuthorityService
from rossec.errors import AuthorityLocked, ConfigurationError, NotDelivered
from rossec.ros.text import printable

PERIOD: Final = 600  # seconds after which grants may have become due
JOIN_PURPOSE: Final = "a node that joins"
APPLY_PURPOSE: Final = "the policy, which it applies"
MAINTENANCE_PURPOSE: Final = "its own maintenance"
_log = logging.getLogger("rossec.authority.service")


class AuthorityWork:
    """The tasks of the service.

    Args:
        rossec_home: ROSSEC_HOME.
        operations: of the key.
        deliver: calls the master. Raises `NotDelivered`.
        policy: the file; None: its usual place.
        now: seconds since the epoch.
    """

    def __init__(
        self,
        rossec_home: Path,
        operations: KeyOperations,
        deliver: Callable[[MasterCall], object],
        policy: Path | None = None,
        now: Callable[[], int] = clock.now,
    ) -> None:
        self._rossec_home = rossec_home
        self._operations = operations
        self._deliver = deliver
        self._policy = policy
        self._now = now
        self._applied: tuple[object, int] = None, 0
        self.published = b""  # the list that the master has from here
        self._published_domains = b""

    @property
    def is_locked(self) -> bool:
        """Whether the key is not held now."""
        return self._operations.held.remaining() is None

    def now(self) -> int:
        """Seconds since the epoch."""
        return self._now()

    def policy_path(self) -> Path:
        """The policy file that the service uses."""
        return policyfile.place(self._rossec_home, self._policy)

    def home(self) -> AuthorityHome:
        """The authority's directory."""
        return AuthorityHome.at(self._rossec_home)

    def join(self, data: bytes) -> tuple[bytes, str | None]:
        """Decide a node's request; returns the message for it, and its name if it was issued.

        Raises:
            EnrollmentMessageRefused: not a request to join.
            HintedError: it could not be decided now; nothing was changed.
        """
        request = JoinRequest.from_bytes(data)
        with self.service(JOIN_PURPOSE) as service:
            try:
                answer = joining.join(service.unlock(), request, self._now())
            except AuthorityLocked:
                with contextlib.closing(service.home.store()) as store:
                    answer = joining.join_locked(store, request, self._now())
        return write(answer), request.name if isinstance(answer, Issued) else None

    def allowed_pattern(self, asked: JoinClaim | JoinRequest) -> str | Refused:
        """The names that the invitation allows whose secret is proved, or why there is no answer.

        Raises:
            HintedError: it could not be decided now.
        """
        with contextlib.closing(self.home().store()) as store:
            return joining.allowed_pattern(store, asked, self._now())

    def was_issued(self, request: JoinRequest) -> bool:
        """Whether there is an identity for exactly this request.

        Raises:
            HintedError: the record cannot be used now.
        """
        with contextlib.closing(self.home().store()) as store:
            return store.identities.issued_for(request.digest) is not None

    def apply(self, names: Collection[str] | None = None) -> None:
        """Make the policy true, for the nodes `names` or for all; does nothing while locked.

        Grants are renewed at two thirds of their time.
        """
        if self.is_locked:
            return
        try:
            policy = policyfile.read_policy(self._rossec_home, self._policy, signs=True)
            with self.service(APPLY_PURPOSE) as service:
                plan = service.plan_policy(policy, names, renew_due=True)
                if plan.signs or plan.revoke:
                    service.apply_policy(plan, lambda text: _log.info("policy: %s", text))
        except NotDelivered as error:
            _log.warning("the policy is applied, but not delivered yet: %s", printable(error))
        except HintedError as error:
            alone = _to_try_alone(error, names)
            for name in alone:
                self.apply([name])
            if not isinstance(error, PolicyRefused):  # a mistake in the file stays one
                self._applied = None, 0
            if not alone:
                _log.error("the policy is not applied: %s", printable(error))

    def grant_outright(self, names: Collection[str]) -> None:
        """Give nodes that joined what the policy in force gives their names, if there is one."""
        try:
            with self.service(APPLY_PURPOSE) as service:
                signed = service.grant_outright(*names, place=self._policy)
                if signed:
                    service.deposit([data for _, data in signed])
        except HintedError as error:
            alone = _to_try_alone(error, names)
            for name in alone:
                self.grant_outright([name])
            if not alone:
                _log.error("%s has no grants yet: %s", ", ".join(names), printable(error))

    def apply_if_changed(self) -> None:
        """As `apply` for all, if the policy or the record changed, or `PERIOD` is over."""
        try:
            status = self.policy_path().stat()
            with contextlib.closing(AuthorityHome.at(self._rossec_home).store()) as store:
                state = status.st_mtime_ns, status.st_size, store.log.head(self._now()).size
        except (HintedError, OSError) as error:
            _log.error("the policy is not applied: %s", printable(error))
            return
        last, at = self._applied
        if state != last or not 0 <= self._now() - at < PERIOD:
            if not self.is_locked:
                self._applied = state, self._now()
            self.apply()

    def maintain(self) -> None:
        """Renew the own node's identity and the list long before they expire; deliver grants."""
        if self.is_locked:
            return
        try:
            with self.service(MAINTENANCE_PURPOSE) as service:
                authority = service.unlock()
                if renewals.own_node_is_due(authority, self._now()):
                    renewals.renew_own_node(authority, self._now())
                service.complete_list()
                self._publish(service)
                service.deposit_missing()
        except HintedError as error:
            _log.warning("maintenance of the authority: %s", printable(error))

    def _publish(self, service: AuthorityService) -> None:
        """Deliver the newest lists, whoever signed them, until the master has taken them."""
        found = service.home.domain_list()
        newest, domains = service.home.revocation_list(), b"" if found is None else found[0]
        if (newest, domains) != (self.published, self._published_domains):
            service.publish()
            self.published, self._published_domains = newest, domains

    @contextlib.contextmanager
    def service(self, purpose: str) -> Iterator[AuthorityService]:
        """What the authority does for its users; `purpose` is audited with every signature.

        For one thread, and closed afterwards. Where the key is needed and not held, it raises
        `AuthorityLocked`.
        """

        def find_signer(home: AuthorityHome) -> OwnSigner:
            self._operations.held.check()
            return OwnSigner(self._operations, home.own_key(), purpose)

        service = AuthorityService(
            self._rossec_home, _no_passphrase, self._deliver, self._now, find_signer
        )
        with contextlib.closing(service):
            yield service


def _to_try_alone(error: HintedError, names: Collection[str] | None) -> Collection[str]:
    """The names to try one by one: the policy is in order, but refused for one of them.

    Or the key of one was revoked in this moment.
    """
    is_of_one = isinstance(error, PolicyRefused | StoreError) and not getattr(error, "mistakes", ())
    return names if is_of_one and names is not None and len(names) > 1 else ()


def _no_passphrase() -> str:
    raise ConfigurationError("the service asks nobody for a passphrase")
