"""What the service does with the key by itself: joins, and with `--apply` what the policy gives.

Called in one thread of its own, in which the record is opened for each task: commands are answered
meanwhile. Signatures are audited like those of commands, with the purpose. Deposits and lists are
passed to the master by the network process; what it does not take is recorded and signed all the same,
and the next round tries again.
"""

import contextlib
import hashlib
import logging
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ca.enrollment.invitation import JoinClaim, JoinRequest
from ca.enrollment.join import Issued, RefusedMessage, RefuseReason, write
from ca.errors import HintedError, RecordUnusable, StoreError
from ca.store.record import Store
from grants.errors import PolicyRefused
from rossec import clock, errors
from rossec.authority import grant_operations, invitations, policyfile, renewals, session
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.operations import KeyOperations, OwnSigner
from rossec.authority.service import AuthorityService
from rossec.peer_limits import printable

PERIOD: Final = 600  # seconds after which grants may have become due
GRACE: Final = 50  # seconds in which a master may be started: less than a round
JOIN_PURPOSE: Final = "a node that joins"
APPLY_PURPOSE: Final = "the policy, which it applies"
MAINTENANCE_PURPOSE: Final = "its own maintenance"
RENEWAL_PURPOSE: Final = "a node that renews its identity"
_log = logging.getLogger("rossec.authority.service")


@dataclass(eq=False, repr=False)
class AuthorityWork:
    """`deliver`: calls the master. Raises `NotDelivered`. `policy`: the file; None: its usual place. `now`:
    seconds since the epoch.
    """

    rossec_home: Path
    operations: KeyOperations
    deliver: Callable[[session.StatementCall], object]
    policy: Path | None = None
    now: Callable[[], int] = clock.now

    def __post_init__(self) -> None:
        self._applied: tuple[object, int] = None, 0
        self._undelivered_since: int | None = None  # nothing reached the master since then
        self.published = b""  # the list that the master has from here
        self._published_domains = b""

    @property
    def is_locked(self) -> bool:
        return self.operations.held.remaining() is None

    def policy_path(self) -> Path:
        return policyfile.place(self.rossec_home, self.policy)

    def home(self) -> AuthorityHome:
        return AuthorityHome.at(self.rossec_home)

    def record(self) -> contextlib.closing[Store]:
        return contextlib.closing(self.home().store())

    def join(self, data: bytes) -> tuple[bytes, str | None]:
        request = JoinRequest.from_bytes(data)
        with self.record() as store:
            if not invitations.is_proved(store, request):  # before the authority is opened
                return write(RefusedMessage(RefuseReason.REFUSED)), None
        with self.service(JOIN_PURPOSE) as service:
            try:
                answer = invitations.join(service.unlock(), request, self.now())
            except errors.AuthorityLocked:
                with contextlib.closing(service.home.store()) as store:
                    answer = invitations.join_locked(store, request, self.now())
        return write(answer), request.name if isinstance(answer, Issued) else None

    def renew_identities(self, requests: Iterable[bytes]) -> list[tuple[bytes, bytes, str]]:
        """Answer nodes whose identity is due: for each request, its SHA-256, a bundle or a reason."""
        # What is signed is in the record, so that the same node gets the same one again. Requests are left
        # out, to be asked for later, when the key is locked meanwhile.
        answers = list[tuple[bytes, bytes, str]]()
        with self.service(RENEWAL_PURPOSE) as service:
            for request in requests:
                bundle, reason = b"", ""
                try:
                    bundle = renewals.renew_recorded(service.unlock(), request, self.now())
                except (errors.AuthorityLocked, RecordUnusable, errors.KeyServiceRefused):
                    break
                except HintedError as error:
                    reason = printable(f"{error} ({error.hint})" if error.hint else str(error))
                    _log.warning("an identity is not renewed: %s", reason)
                except OSError as error:
                    _log.warning("an identity is not renewed: %s", printable(error))
                    break
                except Exception:  # noqa: BLE001 - of one request, which holds no other back
                    reason = "it could not be renewed; the log of the authority's service says why"
                    _log.exception("an identity is not renewed")
                answers.append((hashlib.sha256(request).digest(), bundle, reason))
        return answers

    def allowed_pattern(self, asked: JoinClaim | JoinRequest) -> str | RefusedMessage:
        with self.record() as store:
            return invitations.allowed_pattern(store, asked, self.now())

    def was_issued(self, request: JoinRequest) -> bool:
        with self.record() as store:
            return store.identities.issued_for(request.digest) is not None

    def apply(self, names: Collection[str] | None = None) -> None:
        """Make the policy true, for the nodes `names` or for all; does nothing while locked."""
        # Grants are renewed at two thirds of their time.
        if self.is_locked:
            return
        try:
            policy = policyfile.read_policy(self.rossec_home, self.policy, signs=True)
            with self.service(APPLY_PURPOSE) as service:
                plan = service.policy.plan(policy, names, renew_due=True)
                for reason in plan.refused:
                    _log.error("the policy is not applied: %s", printable(reason))
                if plan.signs or plan.revoke:
                    _apply(service, plan)
        except errors.NotDelivered as error:
            _log.warning("the policy is applied, but not delivered yet: %s", printable(error))
        except errors.PolicyIncomplete as error:
            _log.error("the policy is applied, %s", printable(error))
        except HintedError as error:
            alone = _to_try_alone(error, names)
            for name in alone:
                self.apply([name])
            if not isinstance(error, PolicyRefused):  # a mistake in the file stays one
                self._applied = None, 0
            if not alone:
                _log.error("the policy is not applied: %s", printable(error))

    def grant_outright(self, names: Collection[str]) -> None:
        try:
            with self.service(APPLY_PURPOSE) as service:
                signed = service.policy.grant_outright(*names, place=self.policy)
                if signed:
                    _log_refused(service.grants.deposit([data for _, data in signed]))
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
            with self.record() as store:
                state = status.st_mtime_ns, status.st_size, store.log.head(self.now()).size
        except (HintedError, OSError) as error:
            _log.error("the policy is not applied: %s", printable(error))
            return
        last, at = self._applied
        if state != last or not 0 <= self.now() - at < PERIOD:
            if not self.is_locked:
                self._applied = state, self.now()
            self.apply()

    def maintain(self) -> None:
        """Renew the own node's identity and the list long before they expire; deliver grants."""
        # One that fails holds no other back.
        if self.is_locked:
            return

        def renew_own_node(service: AuthorityService) -> None:
            authority = service.unlock()
            if renewals.own_node_is_due(authority, self.now()):
                renewals.renew_own_node(authority, self.now())

        def deposit_missing(service: AuthorityService) -> None:
            _log_refused(service.grants.deposit_missing()[1])

        steps = (renew_own_node, AuthorityService.complete_list, self._publish, deposit_missing)
        said = ""
        with self.service(MAINTENANCE_PURPOSE) as service:
            for step in steps:
                try:
                    step(service)
                except (HintedError, OSError) as error:
                    if str(error) != said:
                        level = self._level(error)
                        _log.log(level, "maintenance of the authority: %s", printable(error))
                    said = str(error)
                else:
                    if step == self._publish:
                        self._undelivered_since = None

    def _level(self, error: Exception) -> int:
        # A master that is not there yet is no warning: the key is usually unlocked before.
        if not isinstance(error, errors.NotDelivered):
            return logging.WARNING
        if self._undelivered_since is None:
            self._undelivered_since = self.now()
        is_new = not self.published and 0 <= self.now() - self._undelivered_since < GRACE
        return logging.INFO if is_new else logging.WARNING

    def _publish(self, service: AuthorityService) -> None:
        # It is asked in each round whether it has the list still: it may be another master since, or one that
        # was set back to an older state, and would let the revoked in.
        found = service.home.domain_list()
        newest, domains = service.home.revocation_list(), b"" if found is None else found[0]
        known = (newest, domains) == (self.published, self._published_domains)
        with contextlib.suppress(errors.NotDelivered):  # it is away, and asked again
            known = known and service.master_has_list()
        if not known:
            service.publish()
            self.published, self._published_domains = newest, domains

    @contextlib.contextmanager
    def service(self, purpose: str) -> Iterator[AuthorityService]:
        """What the authority does for its users; `purpose` is audited with every signature."""

        # For one thread, and closed afterwards. Where the key is needed and not held, it raises
        # `AuthorityLocked`.
        def find_signer(home: AuthorityHome) -> OwnSigner:
            self.operations.held.check()
            return OwnSigner(self.operations, home.own_key(), purpose)

        service = AuthorityService(self.rossec_home, _no_passphrase, self.deliver, self.now, find_signer)
        with contextlib.closing(service):
            yield service


def _apply(service: AuthorityService, plan: policyfile.PolicyPlan) -> None:
    try:
        service.policy.apply(plan, lambda text: _log.info("policy: %s", text))
    except OSError as error:
        raise errors.NotDelivered(str(error), "the next round tries again") from error


def _log_refused(refused: Iterable[grant_operations.RefusedDeposit]) -> None:
    for each in refused:
        _log.warning("%s", each.say(f"the grant {each.grant_id.hex()[:8]}"))


def _to_try_alone(error: HintedError, names: Collection[str] | None) -> Collection[str]:
    # Or the key of one was revoked in this moment.
    is_of_one = isinstance(error, PolicyRefused | StoreError) and not getattr(error, "mistakes", ())
    return names if is_of_one and names is not None and len(names) > 1 else ()


def _no_passphrase() -> str:
    raise errors.ConfigurationError("the service asks nobody for a passphrase")
