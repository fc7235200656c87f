"""What an authority does about grants: signed by hand or by the policy, and brought to their nodes."""

import contextlib
import secrets
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from ca.errors import HintedError
from ca.names import is_alias
from ca.revocation.lists import RevocationList
from grants import document, request
from grants.model import Draft, Grant, Permission
from grants.renewal import OpenDelegation, open_delegation
from rossec import files
from rossec.authority import domain_operations
from rossec.authority.session import DEPOSIT_SECONDS, AuthoritySession, StatementCall
from rossec.authority.signing import DELEGATIONS, SKEW, SignedGrants
from rossec.errors import ConfigurationError, NotDelivered, PolicyIncomplete
from rossec.home import NodeHome
from rossec.peer_limits import printable
from rossec.ros.names import MASTER

if TYPE_CHECKING:
    from rossec.authority.grant_queue import Denial, GrantRequestQueue, PendingGrantRequest, VerdictChange
    from rossec.authority.policyfile import OptOut, PolicyFile, PolicyPlan


DEPOSIT_LIMIT: Final = 64  # grants in one call: the limit of the master
DEPOSIT_BYTES: Final = 512 * 1024  # in one call, of which the master takes 1 MiB with its envelope
STATES_LIMIT: Final = 256
STATES_SECONDS: Final = 3.0  # a list of grants must not wait for a master that is off

DIRECTORY: Final = "outgoing"  # in the authority's directory
OWNED: Final = (files.Owned(rf"{DIRECTORY}/[0-9a-f]{{1,128}}\.grant"),)
LATER: Final = "deliver it when the master runs: rossec grant deliver"
AGAIN: Final = "rossec grant deliver"
_AFTERWARDS: Final = f"afterwards deliver it with: {AGAIN}"


class RefusedDeposit(NamedTuple):
    """A grant that the master refuses, or that cannot be stored here, and why."""

    grant_id: bytes
    node: str
    reason: str
    is_here: bool = False
    hint: str = ""

    def say(self, grant: str) -> str:
        """One line about it, in which it is called `grant`."""
        if self.is_here:
            return f"{grant} of {self.node} cannot be stored here: {self.reason}"
        return f"the master refuses {grant} of {self.node}: {self.reason}"


SignedGrant = tuple[Draft, bytes]


class Grants:
    """Grants signed by hand and delegations; and how signed grants reach their nodes.

    A node whose directory is in this ROSSEC_HOME gets a file; every other fetches its grants from the
    master, where they are deposited (docs/spec/master.md). No passphrase is needed for that: the master
    accepts deposits from the authority's own node, and the grants are signed.
    """

    def __init__(self, session: AuthoritySession) -> None:
        self._session = session

    def sign(
        self,
        node: str,
        permissions: tuple[Permission, ...],
        lifetime: int,
        renewal: int = 0,
        may_narrow: int = 0,
        certificate: bytes = b"",
    ) -> SignedGrant:
        """Sign a grant for the current key of `node`; the master may renew it for `renewal` s."""
        # `node` may be an alias: `certificate` (PEM) names its key, else one recorded before. It is never
        # renewed: no master of this domain is asked by nodes of others.
        at = self._session.now()
        with self._session.record() as store:
            foreign, root = None, b""
            if is_alias(node) and certificate:
                foreign, root = domain_operations.verify(store, node, certificate, at)
                holder = foreign.thumbprint
            elif is_alias(node):
                holder = domain_operations.holder(store, node, at)
            else:
                holder = store.valid_certificate(node, at).thumbprint
        authority, at = self._session.unlock(), self._session.now()
        span, serial = (at - SKEW, at + lifetime, at + max(lifetime, renewal)), secrets.token_bytes(16)
        draft = Draft(authority.domain, node, holder, *span, serial, permissions, may_narrow=may_narrow)
        if foreign is not None:
            authority.store.domains.add_certificate(root, foreign, at)
        return draft, authority.issue_grant(draft, at)

    def revoke(self, beginning: str, reason: str) -> tuple[RevocationList, bytes]:
        with self._session.record() as store:
            known = [row.id for row in store.grants()]
        found = [each for each in known if beginning and each.hex().startswith(beginning.lower())]
        if len(found) != 1:
            count = "several grants begin" if found else "no grant begins"
            raise ConfigurationError(f"{count} with {beginning!r}", "see: rossec grant list")
        return self._session.unlock().revoke(found[0], reason, self._session.now()), found[0]

    def delegate(
        self, lifetime: int, max_ttl: int, master: str = MASTER
    ) -> tuple[OpenDelegation, StatementCall]:
        authority, at = self._session.unlock(), self._session.now()
        holder = authority.store.valid_certificate(master, at).thumbprint
        data = authority.issue_delegation(holder, lifetime, max_ttl, at)
        hint = (
            f"it is signed and stored in {authority.path / DELEGATIONS}; start the master and run this again"
        )
        call = StatementCall(self._session.home.node(), "rossec.updateDelegation", (data,), "it", hint)
        return open_delegation(data, authority.signer.public_key), call

    def deliver_delegation(self, delegation: OpenDelegation, call: StatementCall) -> None:
        """Deliver what `delegate` returned; from then on grants count as renewed."""
        self._session.deliver(call)
        self._session.home.confirm_delegation(delegation.id, self._session.now())

    def revoke_delegations(self, reason: str) -> tuple[RevocationList, int]:
        return self._session.unlock().revoke_delegations(reason, self._session.now())

    @property
    def outgoing(self) -> Path:
        return self._session.home.path / DIRECTORY

    def store(self, data: bytes) -> Path | None:
        grant = document.peek(data)
        home = NodeHome.of(self._session.rossec_home, grant.subject)
        if not home.path.is_dir():
            return None
        home.add_grant(grant.id, data)
        return home.path

    def deposit(self, grants: Iterable[bytes]) -> list[RefusedDeposit]:
        # Those of nodes of other domains, who ask another master, are put into `outgoing`.
        # What the master has already does no harm. One that lacks the newest list refuses every grant: it is
        # given the list, and asked again. Returns those it refuses, and those that cannot be stored: the disk
        # of one node keeps no other from its grants.
        everything, refused = [], list[RefusedDeposit]()
        for data in grants:
            failed = self.try_to_store(data)
            refused += [] if failed is None else [failed]
            if not is_alias(document.peek(data).subject):
                everything.append(data)
        for batch in _batches(everything):
            here = self._deposit(batch)
            if not here:
                continue
            try:
                lacks_list = not self._session.master_has_list()
                if lacks_list:
                    self._session.publish()
            except (ConfigurationError, NotDelivered) as error:
                hint = f"{error.hint}; {_AFTERWARDS}" if error.hint else _AFTERWARDS
                refused += [each._replace(hint=hint) for each in here]
                continue
            if lacks_list:
                ids = {each.grant_id for each in here}
                here = self._deposit([data for data in batch if document.grant_id(data) in ids])
            refused += here
        return refused

    def try_to_store(self, data: bytes) -> RefusedDeposit | None:
        grant = document.peek(data)
        try:
            if is_alias(grant.subject):
                files.make_private_directory(self.outgoing)
                files.replace(self.outgoing / f"{grant.id.hex()}.grant", data, 0o644)
            else:
                self.store(data)
        except (HintedError, OSError) as error:  # of this node's directory
            reason = printable(getattr(error, "strerror", None) or str(error))
            return RefusedDeposit(grant.id, grant.subject, reason, is_here=True)
        return None

    def deposit_missing(self) -> tuple[int, list[RefusedDeposit]]:
        # Deposit every grant in force that the master does not have.
        # Returns how many it has now besides, and those it refuses or that cannot be stored here.
        states, found = self.delivery_states(within=DEPOSIT_SECONDS), self._in_force()
        missing = [data for grant, data in found if not states.get(grant.id) and not is_alias(grant.subject)]
        refused = self.deposit(missing)
        return len(missing) - sum(not each.is_here for each in refused), refused

    def delivery_states(self, within: float = STATES_SECONDS) -> dict[bytes, str]:
        # `held` (the node has presented it), `fetched`, `waiting`, or empty: the master does not have it.
        ids = [(grant.id, grant.holder) for grant, _ in self._in_force()]
        states: dict[bytes, str] = {}
        for begin in range(0, len(ids), STATES_LIMIT):
            chunk = ids[begin : begin + STATES_LIMIT]
            entries = [grant_id + holder for grant_id, holder in chunk]
            answer = self._ask("rossec.deliveryStates", entries, within)
            states |= zip((grant_id for grant_id, _ in chunk), answer, strict=True)
        return states

    def _ask(self, method: str, items: list[bytes], within: float) -> list[str]:
        what = "the grants" if len(items) != 1 else "the grant"
        call = StatementCall(self._session.home.node(), method, (items,), what, LATER, within=within)
        answer = self._session.deliver(call)
        values = answer if isinstance(answer, list) else []
        texts = [item for item in values if isinstance(item, str)]
        if len(texts) != len(items):
            raise NotDelivered(f"the master's answer about {what} is malformed", LATER)
        return texts

    def _in_force(self) -> Iterator[tuple[Grant, bytes]]:
        now = self._session.now()
        with self._session.record() as store:
            rows, revoked = store.grants(), store.revoked_entries()
        for row in rows:
            grant = document.peek(row.data)
            if now < grant.cap and revoked.isdisjoint((grant.id, grant.holder)):
                yield grant, row.data

    def _deposit(self, batch: list[bytes]) -> list[RefusedDeposit]:
        refused = []
        reasons = self._ask("rossec.depositGrants", batch, DEPOSIT_SECONDS)
        for data, reason in zip(batch, reasons, strict=True):
            if reason:
                grant = document.peek(data)
                refused.append(RefusedDeposit(grant.id, grant.subject, printable(reason), hint=_AFTERWARDS))
        return refused


def require_delivered(refused: Iterable[RefusedDeposit]) -> None:
    """Return if the master has every grant; of those it has, a copy here is not needed."""
    lacking = [each for each in refused if not each.is_here]
    if lacking:
        grants = "1 grant is" if len(lacking) == 1 else f"{len(lacking)} grants are"
        raise NotDelivered(f"{grants} signed, but not delivered", lacking[0].hint or LATER)


def _batches(grants: Iterable[bytes]) -> Iterator[list[bytes]]:
    batch: list[bytes] = []
    size = 0
    for data in grants:
        if len(batch) == DEPOSIT_LIMIT or (batch and size + len(data) > DEPOSIT_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(data)
        size += len(data)
    if batch:
        yield batch


class Decided(NamedTuple):
    grants: SignedGrants
    allowed: int
    waiting: int
    denied: "list[Denial]"


class PolicyWork:
    """Requests decided and answered, the policy applied, nodes that opt out.

    What each of these needs is imported when it is called: most operations of an authority need no policy.
    """

    def __init__(self, session: AuthoritySession, grants: Grants) -> None:
        self._session = session
        self._grants = grants

    def collect_requests(self, policy: "PolicyFile", given: Iterable[bytes] = ()) -> list[str]:
        with self._queue(policy) as queue:
            for data in given:
                queue.add_request(data)
            return queue.read_inbox()

    def pending(self, policy: "PolicyFile") -> "list[PendingGrantRequest]":
        with self._queue(policy) as queue:
            return [item for item in queue.pending() if not item.is_allowed]

    def decide(self, policy: "PolicyFile") -> Decided:
        # One that no grant can have is denied, and keeps no other from its answer.
        with self._queue(policy) as queue:
            pending, grants, refused = queue.pending(), list[SignedGrant](), list["Denial"]()
            allowed = [item for item in pending if item.is_allowed]
            if allowed:
                policy.require_tests()
                grants, refused = queue.sign_each(self._session.unlock(), allowed, "policy")
            waiting = len(pending) - len(allowed)
            denied = [*queue.denied, *refused]
            return Decided(grants, len(allowed) - len(refused), waiting, denied)

    def approve(self, policy: "PolicyFile", beginning: str, change: "VerdictChange") -> SignedGrants:
        # Approve the one pending request whose id begins so, and sign its grants.
        with self._queue(policy) as queue:
            chosen = queue.chosen(beginning)
            return queue.sign(self._session.unlock(), chosen, change, "a person")

    def deny(self, policy: "PolicyFile", beginning: str) -> "list[PendingGrantRequest]":
        # Deny the pending request whose id begins so; returns the rights that were denied.
        with self._queue(policy) as queue:
            chosen = queue.chosen(beginning)
            for item in chosen:
                queue.deny(item, "a person")
            return chosen

    def opt_out(self, policy: "PolicyFile", name: str, *, is_node: bool = False) -> "OptOut":
        # An anonymous node is denied with all others of its identity: a rule tells them not apart.
        from rossec.authority.policyfile import add_denial  # noqa: PLC0415 - see above

        with self._session.record() as store:
            known = name in {row.name for row in store.identities.all()}
            certified = store.identities.certified_name(name, self._session.now())
        if certified != name and (is_node or request.lasting_name(name) != name):
            name, is_node = certified, True
        self._session.unlock()
        return add_denial(policy, name, self._session.now(), is_node=is_node or known)

    def revoke_opted_out(self, opted_out: "OptOut") -> list[tuple[Grant, bytes | None]]:
        from rossec.authority.policyfile import revoke_shown  # noqa: PLC0415 - see above

        return revoke_shown(self._session.unlock(), opted_out, self._session.now())

    def _queue(self, policy: "PolicyFile") -> "contextlib.closing[GrantRequestQueue]":
        from rossec.authority.grant_queue import GrantRequestQueue  # noqa: PLC0415 - see above

        return contextlib.closing(GrantRequestQueue(self._session.home, policy, self._session.now()))

    def plan(
        self,
        policy: "PolicyFile",
        names: Collection[str] | None = None,
        *,
        renew_due: bool = False,
        prune: bool = False,
    ) -> "PolicyPlan":
        # What applying `policy` would change, for the nodes `names` or for all; needs no key.
        from grants.policy.difference import Moment  # noqa: PLC0415 - see above
        from rossec.authority.policyfile import PlanOptions, make_plan  # noqa: PLC0415 - see above

        policy.require_tests()
        with self._session.record() as store:
            at = self._session.now()
            until = self._session.home.renewed_until(at)
            moment = Moment(at, SKEW, renews=at < until, renew_due=renew_due, renewed_until=until or None)
            return make_plan(store, policy, PlanOptions(names, prune), moment)

    def grant_outright(self, *names: str, place: Path | None = None) -> SignedGrants:
        # `place`: of its file; None: the usual one. What it no longer allows waits for `apply`.
        from rossec.authority import policyfile  # noqa: PLC0415 - see above

        if (
            self._session.home.is_intermediate
            or not policyfile.place(self._session.rossec_home, place).exists()
        ):
            return []
        policy = policyfile.read_policy(self._session.rossec_home, place, signs=True)
        policy.require_tests()
        at = self._session.now()
        until = self._session.home.renewed_until(at)
        return policyfile.grant_outright(
            self._session.unlock(), policy, names, at, renewed_until=until or None
        )

    def apply(self, plan: "PolicyPlan", report: Callable[[str], None] = lambda _: None) -> SignedGrants:
        # `report` is called with each step that was done. Returns the new grants.
        from rossec.authority import policyfile  # noqa: PLC0415 - see above

        authority, failed = self._session.unlock(), list[HintedError | OSError]()
        # 1. What is only taken away goes first: it waits for nothing.
        listed, left = policyfile.take_away(authority, plan, self._session.now())
        if listed is not None:
            report(f"revoked: {len(plan.taken)} (list {listed.seq})")
            self._publish_new(report, failed)
        # 2. What is new is signed and delivered.
        signed, left = policyfile.sign_each(authority, left, self._session.now())
        if signed:
            report(f"signed: {len(signed)}")
        refused = self._deliver_new(signed, left, failed)
        # 3. What that replaces goes, and what is not allowed, whether or not the new ones were delivered.
        listed = policyfile.revoke_planned(authority, left, self._session.now())
        if listed is not None:
            report(f"revoked: {len(left.revoke)} (list {listed.seq})")
            self._publish_new(report, failed)
        if refused and plan.revoke and not failed:  # there may be room for them now
            refused = self._grants.deposit_missing()[1]
        for each in refused:
            report(each.say("a grant"))
        for reason in left.refused:
            report(f"not granted: {reason}")
        if failed:
            raise failed[-1]
        require_delivered(refused)
        require_complete(left)
        return signed

    def _publish_new(self, report: Callable[[str], None], failed: list[HintedError | OSError]) -> None:
        # Deliver the list; a failure is kept, since what comes after it does not need it.
        try:
            self._session.publish()
        except (HintedError, OSError) as error:
            failed.append(error)
        else:
            report("the master has the new list")

    def complete(self) -> None:
        with self._session.record() as store:
            ours, revoked = store.policy_grants().keys(), store.revoked_entries()
        refused = self._deposit_all() if ours else []
        if not revoked.isdisjoint(ours):
            self._session.publish()
        require_delivered(refused)

    def _deliver_new(
        self, signed: SignedGrants, plan: "PolicyPlan", failed: list[HintedError | OSError]
    ) -> list[RefusedDeposit]:
        # Before a revocation, also those that an interrupted command signed: they replace what goes. A node
        # of this ROSSEC_HOME has its grants as files, also while no master runs.
        try:
            if plan.revoke:
                return self._deposit_all()
            return self._grants.deposit(data for _, data in signed)
        except NotDelivered as error:
            homes = (NodeHome.of(self._session.rossec_home, draft.subject) for draft, _ in signed)
            if not all(home.path.is_dir() for home in homes):
                failed.append(error)
        except (HintedError, OSError) as error:  # a full disk, or an expired identity of /ca
            failed.append(error)
        return []

    def _deposit_all(self) -> list[RefusedDeposit]:
        with self._session.record() as store:
            rules, rows = store.policy_grants(), store.unrevoked_grants()
        refused = []
        for row in rows:
            home = NodeHome.of(self._session.rossec_home, row.name)
            lacks = home.path.is_dir() and not home.grant_file(row.id).exists()
            if lacks and row.id in rules and self._session.now() < row.expires:
                refused.append(self._grants.try_to_store(row.data))
        return [each for each in refused if each is not None] + self._grants.deposit_missing()[1]


def require_complete(plan: "PolicyPlan") -> None:
    if plan.refused:
        more = len(plan.refused) - 1
        rest = f" (and {more} more)" if more else ""
        raise PolicyIncomplete(
            f"in force, except: {plan.refused[0]}{rest}",
            "write fewer or narrower rules for this node; all others have what the policy says",
        )
