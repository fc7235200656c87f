"""The plan to put a policy in force: for each node, what to sign and revoke. Changes nothing.

The record is the authority's own, so its grants are read without verifying their signatures again.
The wanted state is that of the nodes with a valid identity; `/ca` and `/master` act by their
identity and get none. The grants of other keys only lose what the policy no longer allows.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Final

from ca.encoding import Value, encode
from ca.errors import RevocationRefused
from ca.names import is_reserved
from ca.revocation.lists import MAX_ENTRIES
from ca.revocation.tree import MAX_LEAVES
from ca.store.record import Store
from grants import claims, document
from grants.model import ID_SIZE, KEY_SIZE, Draft, Grant, Permission
from grants.policy.difference import (
    Contradiction,
    Moment,
    NodeDifference,
    RecordedGrant,
    atoms,
    difference,
)
from grants.policy.model import Subject
from grants.policy.wanted import WantedRight, WantedState, rule_ids
from rossec.authority import foreign_nodes, list_contents
from rossec.authority.list_contents import SKEW
from rossec.authority.policyfile import PolicyFile

_Holder = tuple[str, bytes]
"""The name of a node and the thumbprint of a key."""

_OVER: Final = "apply it in parts (--node NAME), or wait until revoked grants have expired"


@dataclass(frozen=True)
class PlanOptions:
    """What is asked of a plan.

    Args:
        names: only these nodes; None for all.
        prune: revoke grants made by hand against a denial; what else they allow is granted anew.
    """

    names: Collection[str] | None = None
    prune: bool = False


@dataclass(frozen=True)
class PolicyPlan:
    """What applying a policy would do.

    Args:
        pruned: grants made by hand that go, each with what it allows and the policy does not deny.
        entries: of the log of the record from which it was made.
        listed: the number of entries of the revocation list afterwards; 0 if nothing is revoked.
    """

    policy: PolicyFile
    options: PlanOptions
    moment: Moment
    nodes: tuple[NodeDifference, ...]
    pruned: tuple[tuple[Grant, tuple[Permission, ...]], ...]
    entries: int
    listed: int = 0

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to do."""
        return not self.revoke and self.signs == 0

    @property
    def signs(self) -> int:
        """The number of grants to sign."""
        return sum(len(node.sign) for node in self.nodes) + sum(
            1 for _, left in self.pruned if left
        )

    @property
    def revoke(self) -> tuple[Grant, ...]:
        """The grants to revoke."""
        gone = [grant for node in self.nodes for grant in node.revoke]
        return (*gone, *(grant for grant, _ in self.pruned))

    @property
    def refused(self) -> tuple[str, ...]:
        """Why some of what the policy allows is in no grant: of these nodes, and of no other."""
        return tuple(reason for node in self.nodes for reason in node.refused)

    @property
    def taken(self) -> tuple[Grant, ...]:
        """Of the grants to revoke those of which nothing is signed anew."""
        return tuple(grant for node in self.nodes for grant in node.taken)

    def without(self, taken: Iterable[Grant], entries: int) -> "PolicyPlan":
        """What is left to do when `taken` are revoked, and the log of the record has `entries`."""
        gone = {grant.id for grant in taken}
        nodes = tuple(
            replace(node, revoke=tuple(each for each in node.revoke if each.id not in gone))
            for node in self.nodes
        )
        return replace(self, nodes=nodes, entries=entries)

    @property
    def contradictions(self) -> tuple[Contradiction, ...]:
        """What grants made by hand allow against a denial, and will allow afterwards."""
        if self.options.prune:
            return ()
        return tuple(each for node in self.nodes for each in node.contradictions)

    @property
    def needs_tree(self) -> bool:
        """Whether there will be more revocations than a list holds."""
        return self.listed > MAX_ENTRIES

    @property
    def ends(self) -> int | None:
        """When the first right from the policy ends, seconds; None without any."""
        return min((node.ends for node in self.nodes if node.ends is not None), default=None)

    def effect(self, domain: str) -> bytes:
        """The digest of what it signs and revokes; plans that do the same have the same, whenever.

        SHA-256 of the CBOR of the claims of its grants, as if they were signed at the time `SKEW`
        with serials of zeros by a key with a thumbprint of zeros, and of the ids that it revokes.
        """
        drafts = self.drafts(domain, SKEW, lambda: bytes(ID_SIZE))
        signs: list[Value] = [
            [claims.from_draft(draft, bytes(KEY_SIZE)), rules] for draft, rules in drafts
        ]
        revokes: list[Value] = [*sorted(grant.id for grant in self.revoke)]
        return sha256(encode([signs, revokes])).digest()

    def drafts(
        self, domain: str, now: int, serial: Callable[[], bytes]
    ) -> Iterator[tuple[Draft, str]]:
        """The grants to sign at `now`, each with the rules it comes from."""
        for node in self.nodes:
            for group in node.sign:
                yield _draft(domain, node.subject, group, now, serial())
        for grant, left in self.pruned:
            if left and now < grant.expires:
                draft = Draft(
                    domain, grant.subject, grant.holder, grant.not_before, grant.expires,
                    grant.cap, serial(), left,
                )  # fmt: skip
                yield draft, ""


def make_plan(store: Store, policy: PolicyFile, options: PlanOptions, moment: Moment) -> PolicyPlan:
    """Compare what `policy` allows outright with the grants in the record.

    A node that cannot get all of it, or has more to lose than a list has room for, is among its
    `refused`, and changes nothing for the others.

    Raises:
        RevocationRefused: more would be pruned than a list can hold.
    """
    state = WantedState(policy.decider)
    with store.database.read_transaction():
        recorded = _recorded(store, options.names, moment.now)
        getting = _subjects(store, options.names, moment.now)
        nodes = tuple(
            difference(
                state, getting.get(each, Subject(*each)), recorded.get(each, ()), moment,
                gets=each in getting,
            )
            for each in sorted(getting.keys() | recorded.keys())
        )  # fmt: skip
        pruned = tuple(_pruned(nodes)) if options.prune else ()
        plan = PolicyPlan(policy, options, moment, nodes, pruned, store.log.head(0).size)
        return _measured(store, plan)


def _subjects(store: Store, names: Collection[str] | None, now: int) -> dict[_Holder, Subject]:
    """The nodes that may get grants, with their present keys."""
    found = (
        store.identities.all_valid(now)
        if names is None
        else [row for name in names for row in store.identities.valid(name, now)]
    )
    newest = {row.name: row for row in found if row.name.startswith("/")}
    own = [
        Subject(name, row.thumbprint, row.wildcard)
        for name, row in newest.items()
        if not is_reserved(name)
    ]
    foreign = foreign_nodes.subjects(store, now)
    admitted = [each for each in foreign if names is None or each.name in names]
    return {(each.name, each.key): each for each in (*own, *admitted)}


def _recorded(
    store: Store, names: Collection[str] | None, now: int
) -> dict[_Holder, list[RecordedGrant]]:
    """The grants that are or can be in force, by node and key."""
    revoked, rules = store.revoked_entries(), store.policy_grants(names)
    found: dict[_Holder, list[RecordedGrant]] = {}
    for row in store.unrevoked_grants(names):
        grant = document.peek(row.data)
        if now < grant.cap and grant.holder not in revoked:
            of = found.setdefault((grant.subject, grant.holder), [])
            of.append(RecordedGrant(grant, rules.get(row.id, "")))
    return found


def _pruned(
    nodes: tuple[NodeDifference, ...],
) -> Iterator[tuple[Grant, tuple[Permission, ...]]]:
    for node in nodes:
        denied: dict[bytes, set[tuple[int, str]]] = {}
        for each in node.contradictions:
            denied.setdefault(each.grant.id, set()).add((each.right, each.pattern))
        for grant in {each.grant.id: each.grant for each in node.contradictions}.values():
            kept = [
                entries for atom, entries in atoms(grant).items() if atom not in denied[grant.id]
            ]
            yield grant, tuple(item for entries in kept for item in entries)


def _measured(store: Store, plan: PolicyPlan) -> PolicyPlan:
    """The plan with the length of the list that it would make."""
    gone = {grant.id for grant in plan.revoke}
    if not gone:
        return plan
    listed = len(list_contents.required_entries(store, plan.moment.now) | gone)
    if listed <= MAX_LEAVES:
        return replace(plan, listed=listed)
    why = f"a list has room for {MAX_LEAVES} revocations, this would make {listed}"
    if plan.pruned:
        raise RevocationRefused(why, _OVER)
    return _within(plan, MAX_LEAVES - (listed - len(gone)), why)


def _within(plan: PolicyPlan, room: int, why: str) -> PolicyPlan:
    """What of a plan can be revoked: of each node all, of those with fewest first."""
    room, nodes = max(0, room), list(plan.nodes)
    left = room
    for at in sorted(range(len(nodes)), key=lambda at: len(nodes[at].revoke)):
        if len(nodes[at].revoke) > left:
            nodes[at] = nodes[at].without_room(left, why)
        left -= len(nodes[at].revoke)
    return replace(plan, nodes=tuple(nodes), listed=MAX_LEAVES - left)


def _draft(
    domain: str, subject: Subject, group: tuple[WantedRight, ...], now: int, serial: bytes
) -> tuple[Draft, str]:
    lifetime = min(each.lifetime for each in group)
    renewal = min(max(each.lifetime, each.renew_until) for each in group)
    draft = Draft(
        domain=domain, subject=subject.name, holder=subject.key,
        not_before=now - SKEW, expires=now + lifetime, cap=now + renewal, serial=serial,
        permissions=tuple(item for each in group for item in each.permissions),
    )  # fmt: skip
    return draft, rule_ids(rule for each in group for rule in each.rules)
