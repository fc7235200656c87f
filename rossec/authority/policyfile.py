"""The policy file of an authority, the plan to put it in force, and the plan carried out.

Without a file there is no policy, and it permits nothing. A plan changes nothing.

Carried out, what is only taken away goes first; then what is new is signed, and what that replaces goes, so
that no node is without what it keeps. Each step is one transaction: cut off between the last two, the next
plan finds the new ones exact, and what is left is to revoke the old.
"""

import secrets
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple, Self

from ca.encoding import Value, encode
from ca.errors import HintedError, RevocationRefused
from ca.names import is_reserved
from ca.revocation.lists import MAX_ENTRIES, MAX_LEAVES, RevocationList
from ca.store.record import Store
from grants import document
from grants.errors import PolicyRefused
from grants.model import ID_SIZE, KEY_SIZE, Draft, Grant, Permission, Right
from grants.policy import decision, source
from grants.policy.difference import Contradiction, Moment, NodeDifference, RecordedGrant, atoms, difference
from grants.policy.learn import NewRule, add_rules, free_id
from grants.policy.model import Policy, Subject
from grants.policy.names import intersects
from grants.policy.read import load
from grants.policy.wanted import WantedRight, WantedState, rule_ids
from rossec import files
from rossec.authority import domain_operations, signing
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import CLOCK_SKEW, OF_ALL, SKEW, SignedGrants, SigningAuthority
from rossec.errors import ConfigurationError
from rossec.participant.host_types import definition_of, layout_of
from rossec.participant.message_types import type_names

__all__ = ["NAME", "PolicyFile", "layout_of", "parse_policy", "place", "read_policy"]

NAME: Final = "policy.yaml"
OWNED: Final = (files.Owned(r"policy\.yaml", stays=True),)


@dataclass(frozen=True)
class PolicyFile:
    path: Path
    text: str
    policy: Policy

    @classmethod
    def read(cls, path: Path, *, own: bool = False) -> Self:
        """Read the policy in `path`; with `own`, only if no other user can write it."""
        missing = ConfigurationError(f"there is no policy in {path}", "next: rossec policy init")
        try:
            text = (
                files.read_own(path, source.MAX_SIZE, missing, link=True)
                if own
                else files.read(path, source.MAX_SIZE, missing)
            ).decode()
        except UnicodeDecodeError:
            raise ConfigurationError(f"{path} is not UTF-8", "is it the right file?") from None
        return cls(path, text, parse_policy(text, str(path)))

    def replace(self, text: str) -> "PolicyFile":
        policy = parse_policy(text, str(self.path))
        with files.locked_directory(self.path.parent):
            if self.path.exists():  # otherwise it is a new file
                self.check_unchanged()
            # the target of a link
            files.replace(self.path.resolve(), text.encode(), 0o644, keep=True)
        return PolicyFile(self.path, text, policy)

    def check_unchanged(self) -> None:
        gone = ConfigurationError(f"{self.path} is gone, nothing was done", "write a policy first")
        if files.read(self.path, source.MAX_SIZE, gone) != self.text.encode():
            raise ConfigurationError(
                f"{self.path} was changed while this command was running, nothing was done",
                "run the command again: it then uses the new policy",
            )

    def require_tests(self) -> None:
        from grants.policy.assertion_check import require_tests  # noqa: PLC0415 - few need it

        if self.policy.tests:
            require_tests(self.policy, layout_of)

    @property
    def decider(self) -> decision.Decider:
        return decision.Decider(self.policy)


def place(home: Path, given: Path | None) -> Path:
    return given if given is not None else home / "ca" / NAME


def read_policy(home: Path, given: Path | None, *, signs: bool = False) -> PolicyFile:
    """The policy at its place; if it is in force or `signs`, no other user may have written it."""
    if given is None and not place(home, None).exists():
        AuthorityHome.at(home)  # where there is none, that is the mistake
    return PolicyFile.read(place(home, given), own=signs or given is None)


def parse_policy(text: str, file: str) -> Policy:
    return load(text, definition_of, file=file, known_types=type_names())


_Holder = tuple[str, bytes]
"""The name of a node and the thumbprint of a key."""

_OVER: Final = "apply it in parts (--node NAME), or wait until revoked grants have expired"


@dataclass(frozen=True)
class PlanOptions:
    """`names`: only these nodes; None for all. `prune`: revoke grants made by hand against a denial; what
    else they allow is granted anew.
    """

    names: Collection[str] | None = None
    prune: bool = False


@dataclass(frozen=True)
class PolicyPlan:
    """`pruned`: grants made by hand that go, each with what it allows and the policy does not deny.
    `entries`: of the log of the record from which it was made. `listed`: the number of entries of the
    revocation list afterwards; 0 if nothing is revoked.
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
        return not self.revoke and self.signs == 0

    @property
    def signs(self) -> int:
        return sum(len(node.sign) for node in self.nodes) + sum(1 for _, left in self.pruned if left)

    @property
    def revoke(self) -> tuple[Grant, ...]:
        gone = [grant for node in self.nodes for grant in node.revoke]
        return (*gone, *(grant for grant, _ in self.pruned))

    @property
    def refused(self) -> tuple[str, ...]:
        return tuple(reason for node in self.nodes for reason in node.refused)

    @property
    def taken(self) -> tuple[Grant, ...]:
        return tuple(grant for node in self.nodes for grant in node.taken)

    def without(self, taken: Iterable[Grant], entries: int) -> "PolicyPlan":
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
        return self.listed > MAX_ENTRIES

    @property
    def ends(self) -> int | None:
        return min((node.ends for node in self.nodes if node.ends is not None), default=None)

    def effect(self, domain: str) -> bytes:
        """The digest of what it signs and revokes; plans that do the same have the same, whenever."""
        # SHA-256 of the CBOR of the claims of its grants, as if they were signed at the time `SKEW` with
        # serials of zeros by a key with a thumbprint of zeros, and of the ids that it revokes.
        drafts = self.drafts(domain, CLOCK_SKEW, lambda: bytes(ID_SIZE))
        signs: list[Value] = [[document.from_draft(draft, bytes(KEY_SIZE)), rules] for draft, rules in drafts]
        revokes: list[Value] = [*sorted(grant.id for grant in self.revoke)]
        return sha256(encode([signs, revokes])).digest()

    def drafts(self, domain: str, now: int, serial: Callable[[], bytes]) -> Iterator[tuple[Draft, str]]:
        for node in self.nodes:
            for group in node.sign:
                yield _draft(domain, node.subject, group, now, serial())
        for grant, left in self.pruned:
            if left and now < grant.expires:
                who, span = (grant.subject, grant.holder), (grant.not_before, grant.expires, grant.cap)
                yield Draft(domain, *who, *span, serial(), left), ""


def make_plan(store: Store, policy: PolicyFile, options: PlanOptions, moment: Moment) -> PolicyPlan:
    """Compare what `policy` allows outright with the grants in the record."""
    # A node that cannot get all of it, or has more to lose than a list has room for, is among its `refused`,
    # and changes nothing for the others.
    state = WantedState(policy.decider)
    with store.database.read_transaction():
        names = options.names
        revoked, rules = store.revoked_entries(), store.policy_grants(names)
        recorded: dict[_Holder, list[RecordedGrant]] = {}
        for row in store.unrevoked_grants(names):
            grant = document.peek(row.data)  # not verified again: the record is the authority's own
            if moment.now < grant.cap and grant.holder not in revoked:
                of = recorded.setdefault((grant.subject, grant.holder), [])
                of.append(RecordedGrant(grant, rules.get(row.id, "")))
        getting = _subjects(store, names, moment.now)
        nodes = tuple(
            difference(
                state, getting.get(each, Subject(*each)), recorded.get(each, ()), moment, gets=each in getting
            )
            for each in sorted(getting.keys() | recorded.keys())
        )
        pruned = tuple(_pruned(nodes)) if options.prune else ()
        plan = PolicyPlan(policy, options, moment, nodes, pruned, store.log.head(0).size)
        gone = {grant.id for grant in plan.revoke}
        if not gone:
            return plan
        listed = len(signing.required_entries(store, moment.now) | gone)
    # A list that is longer could not be signed: then no revocation at all could be put in force.
    if listed <= MAX_LEAVES:
        return replace(plan, listed=listed)
    why = f"a list has room for {MAX_LEAVES} revocations, this would make {listed}"
    if plan.pruned:
        raise RevocationRefused(why, _OVER)
    return _within(plan, MAX_LEAVES - (listed - len(gone)), why)


def _subjects(store: Store, names: Collection[str] | None, now: int) -> dict[_Holder, Subject]:
    found = (
        store.identities.all_valid(now)
        if names is None
        else [row for name in names for row in store.identities.valid(name, now)]
    )
    # `/ca` and masters act by their identity and get none; other keys than the newest only lose grants.
    newest = {row.name: row for row in found if row.name.startswith("/")}
    own = [
        Subject(name, row.thumbprint, row.wildcard) for name, row in newest.items() if not is_reserved(name)
    ]
    foreign = domain_operations.subjects(store, now)
    admitted = [each for each in foreign if names is None or each.name in names]
    return {(each.name, each.key): each for each in (*own, *admitted)}


def _pruned(nodes: tuple[NodeDifference, ...]) -> Iterator[tuple[Grant, tuple[Permission, ...]]]:
    for node in nodes:
        denied: dict[bytes, set[tuple[int, str]]] = {}
        for each in node.contradictions:
            denied.setdefault(each.grant.id, set()).add((each.right, each.pattern))
        for grant in {each.grant.id: each.grant for each in node.contradictions}.values():
            kept = [entries for atom, entries in atoms(grant).items() if atom not in denied[grant.id]]
            yield grant, tuple(item for entries in kept for item in entries)


def _within(plan: PolicyPlan, room: int, why: str) -> PolicyPlan:
    # Those that lose least first, so that as many nodes as possible get what the policy says.
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
    span = now - CLOCK_SKEW, now + lifetime, now + renewal
    permissions = tuple(item for each in group for item in each.permissions)
    draft = Draft(domain, subject.name, subject.key, *span, serial, permissions)
    return draft, rule_ids(rule for each in group for rule in each.rules)


def sign_planned(authority: SigningAuthority, plan: PolicyPlan, now: int) -> SignedGrants:
    def check() -> None:
        plan.policy.check_unchanged()
        check_record(authority, plan)

    signed = _sign(authority, plan, now, check)
    if not signed:
        plan.policy.check_unchanged()  # what it revokes is to be what this policy denies
    return signed


def take_away(
    authority: SigningAuthority, plan: PolicyPlan, now: int
) -> tuple[RevocationList | None, PolicyPlan]:
    taken = plan.taken
    if not taken or not plan.signs:
        return None, plan
    with authority.store.transaction():
        plan.policy.check_unchanged()
        check_record(authority, plan)
        listed = authority.revoke_all(frozenset(each.id for each in taken), _reason(plan), now)
        return listed, plan.without(taken, authority.store.log.head(0).size)


def sign_each(authority: SigningAuthority, plan: PolicyPlan, now: int) -> tuple[SignedGrants, PolicyPlan]:
    """As `sign_planned`, and where it refuses, for each node alone."""
    # Returns the grants, and the plan with what is refused: what it revokes is left to do.
    try:
        return sign_planned(authority, plan, now), plan
    except OF_ALL:
        raise
    except HintedError:
        plan.policy.check_unchanged()
        check_record(authority, plan)
    signed: SignedGrants = []
    nodes, pruned = [], []
    for node in plan.nodes:
        try:
            alone = replace(plan, nodes=(node,), pruned=())
            signed += _sign(authority, alone, now, plan.policy.check_unchanged)
        except OF_ALL:
            raise
        except HintedError as error:
            node = node.without_signing(str(error))  # noqa: PLW2901 - what is left of it
        nodes.append(node)
    for grant, left in plan.pruned:
        try:
            alone = replace(plan, nodes=(), pruned=((grant, left),))
            signed += _sign(authority, alone, now, plan.policy.check_unchanged)
        except OF_ALL:
            raise
        except HintedError as error:
            against = ([each.grant for each in node.contradictions] for node in nodes)
            at = next(at for at, found in enumerate(against) if grant in found)
            nodes[at] = replace(nodes[at], refused=(*nodes[at].refused, f"{grant.subject}: {error}"))
            left = ()  # noqa: PLW2901 - it goes all the same
        pruned.append((grant, left))
    return signed, replace(plan, nodes=tuple(nodes), pruned=tuple(pruned))


def _sign(authority: SigningAuthority, plan: PolicyPlan, now: int, check: Callable[[], None]) -> SignedGrants:
    drafts = list(plan.drafts(authority.domain, now, lambda: secrets.token_bytes(ID_SIZE)))
    signed = authority.issue_grants(drafts, now, check) if drafts else []
    return [(draft, data) for (draft, _), data in zip(drafts, signed, strict=True)]


def grant_outright(
    authority: SigningAuthority,
    policy: PolicyFile,
    names: Collection[str],
    now: int,
    *,
    renewed_until: int | None = None,
) -> SignedGrants:
    """Sign what `policy` gives the nodes `names` outright and they do not have; revokes nothing."""
    # `renewed_until`: until when the master can renew grants; None: it cannot.
    renews = renewed_until is not None
    moment = Moment(now, SKEW, renews=renews, renewed_until=renewed_until)
    plan = make_plan(authority.store, policy, PlanOptions(names), moment)
    if plan.refused and (len(plan.nodes) > 1 or not plan.signs):
        raise PolicyRefused(plan.refused[0], "see: rossec policy apply --dry-run")
    return sign_planned(authority, plan, now)


def check_record(authority: SigningAuthority, plan: PolicyPlan) -> None:
    # In the transaction that signs: a plan made from another record than there is now does nothing.
    if authority.store.log.head(0).size == plan.entries:
        return
    again = make_plan(authority.store, plan.policy, plan.options, plan.moment)
    if (again.nodes, again.pruned) != (plan.nodes, plan.pruned):
        raise ConfigurationError(
            "the authority's record was changed meanwhile, nothing was done",
            "run the command again: it then compares with the record of now",
        )


def revoke_planned(authority: SigningAuthority, plan: PolicyPlan, now: int) -> RevocationList | None:
    gone = frozenset(grant.id for grant in plan.revoke)
    return authority.revoke_all(gone, _reason(plan), now) if gone else None


def _reason(plan: PolicyPlan) -> str:
    return f"policy {plan.policy.policy.robot}"


class OptOut(NamedTuple):
    # The policy is changed first. The grants are then revoked with the record locked: a decision by the old
    # policy is signed already, or cannot be (`GrantRequestQueue.sign`). What else they allowed is granted
    # anew.

    policy: PolicyFile
    rule: str
    name: str
    is_node: bool

    def denies(self, permission: Permission) -> bool:
        shows = Right.SUBSCRIBE in permission.rights
        return shows and (self.is_node or intersects(permission.pattern, self.name))

    def affects(self, grant: Grant) -> bool:
        concerns = not self.is_node or grant.subject == self.name
        return concerns and any(self.denies(permission) for permission in grant.permissions)


def add_denial(policy: PolicyFile, name: str, now: int, *, is_node: bool) -> OptOut:
    day = time.strftime("%Y-%m-%d", time.gmtime(now))
    prefix = "opt-out" + name.replace("/", "-").replace("*", "any")[:60]
    rule = NewRule(
        free_id([item.id for item in policy.policy.rules], prefix),
        f"opted out {day}",
        name if is_node else "*",
        "deny",
        {"subscribe": ["/**" if is_node else name]},
    )
    return OptOut(policy.replace(add_rules(policy.text, [rule])), rule.id, name, is_node)


def revoke_shown(
    authority: SigningAuthority, opted_out: OptOut, now: int
) -> list[tuple[Grant, bytes | None]]:
    """Revoke all grants that hold, or will, and show what is denied; or, if one fails, none."""
    # They are returned with the signed grants of their other rights, where there are any.
    store = authority.store
    with store.transaction():
        revoked, rules = store.revoked_entries(), store.policy_grants()
        grants = [document.peek(row.data) for row in store.grants()]
        return [
            (grant, _revoke(authority, grant, opted_out, now, rules.get(grant.id, "")))
            for grant in grants
            if revoked.isdisjoint((grant.id, grant.holder)) and now < grant.cap and opted_out.affects(grant)
        ]


def _revoke(
    authority: SigningAuthority, grant: Grant, opted_out: OptOut, now: int, rules: str
) -> bytes | None:
    authority.revoke(grant.id, f"opted out of {opted_out.name}", now)
    permissions: list[Permission] = []
    for item in grant.permissions:
        rights = item.rights & ~Right.SUBSCRIBE if opted_out.denies(item) else item.rights
        if rights:
            permissions.append(replace(item, rights=rights))
    if not permissions or grant.expires <= now:
        return None
    about = grant.domain, grant.subject, grant.holder, grant.not_before, grant.expires, grant.cap
    draft = Draft(*about, secrets.token_bytes(16), tuple(permissions))
    return authority.issue_grant(draft, now, rules)
