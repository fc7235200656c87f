"""The calls about the authority's statements: grants, delegations, revocations, domains, renewals. Pure.

Lists and delegations carry the authority's signature, so any authenticated node may deliver one; a
node verifies whatever it is answered. What only the authority's own node may call, and what only
members of the domain, says `rossec.master.rights.access_rules`.
"""

from collections.abc import Callable, Iterable
from typing import Final

from ca.errors import HintedError
from ca.names import is_alias
from grants.model import Grant, Right
from rossec.master.api import arguments as arg
from rossec.master.api.arguments import ArgumentRefused
from rossec.master.api.methods import (
    Administered,
    CallerPresentedGrants,
    CallRequest,
    DomainsChanged,
    GrantsDeposited,
    Method,
    Methods,
    Reply,
    RevocationsChanged,
    Steps,
)
from rossec.master.rights.caller import CertifiedPeer, RecentDenials, Refused, refusals_answered
from rossec.master.rights.held_grants import DeliveryState, Deposits
from rossec.master.rights.renewals import OFFER_LIMIT, Settlement
from rossec.master.rights.revocation_lists import RevocationQueries
from rossec.master.rights.statements import TrustState
from rossec.master.state.journals import ID_SIZE
from rossec.master.state.registry import Kind, Registry
from rossec.ros.names import (
    DOMAINS,
    FOREIGN_PROOFS,
    FOREIGN_REVOCATIONS,
    RENEW_IDENTITY,
    SETTLE_RENEWALS,
    UPDATE_DOMAINS,
    WATCH_RENEWALS,
)

PRESENT_LIMIT: Final = 64
RENEW_LIMIT: Final = 16
PROOF_LIMIT: Final = 64


class StatementCalls:
    """Handlers over one `TrustState`; `master`, on whose name ADMIN is a right, began at `started`."""

    def __init__(
        self, statements: TrustState, registry: Registry, master: str, started: int, deposits: Deposits
    ) -> None:
        self._statements = statements
        self._registry = registry
        self._master = master
        self._queries = RevocationQueries(started)
        self._deposits = deposits

    def methods(self) -> Methods:
        grants = arg.binaries("grants", PRESENT_LIMIT)
        renewed = arg.binaries("grants", RENEW_LIMIT)
        return {
            "rossec.presentGrants": Method((grants,), 0, self._present),
            "rossec.renewGrants": Method((renewed,), [], self._renew),
            "rossec.updateDelegation": Method((arg.binary("delegation"),), 0, self._update_delegation),
            "rossec.revocations": Method((), [], self._revocations),
            "rossec.revocationsSince": Method((arg.binary("digest"),), [], self._since),
            "rossec.updateRevocations": Method((arg.binary("list"),), 0, self._update),
            "rossec.updateRevocationTree": Method(
                (arg.binary("tree"), arg.binary("entries")), 0, self._update_tree
            ),
            "rossec.revocationEntries": Method((), b"", self._entries),
            "rossec.revocationProofs": Method((arg.binaries("entries", PROOF_LIMIT),), [], self._proofs),
            "rossec.trl": Method((arg.binary("query"),), b"", self._query),
        }

    def _present(self, request: CallRequest) -> Steps:
        tokens, reasons = request.binaries(1), list[str]()
        for token in tokens:
            reasons += self._statements.present(request.caller, [token], request.now).refused
            yield
        presented = self._statements.present(request.caller, [], request.now)
        self._deposits.presented(request.caller.thumbprint, tokens)
        refused = "; ".join(reasons)
        # No error even if all are refused: a node whose grants have expired keeps its session and
        # presents new ones in it.
        status = f"grants presented, but refused: {refused}" if refused else "grants accepted"
        event = CallerPresentedGrants(request.caller.identity, tuple(reasons))
        return Reply(presented.held, status, events=(event,))

    def _renew(self, request: CallRequest) -> Reply:
        renewed = self._statements.renew(request.caller, request.binaries(1), request.now)
        refused = "; ".join(renewed.refused)
        status = f"grants renewed, but refused: {refused}" if refused else "grants renewed"
        event = CallerPresentedGrants(request.caller.identity, renewed.refused)
        return Reply(list(renewed.tokens), status, events=(event,))

    def _update_delegation(self, request: CallRequest) -> Reply:
        with refusals_answered():
            newer = self._statements.update_delegation(request.binary(1))
        if not newer:
            return Reply(0, "not newer than the delegation held")
        delivered = Administered(request.caller.identity, "delivered a delegation to renew grants")
        return Reply(1, "delegated", events=(delivered,))

    def _revocations(self, request: CallRequest) -> Reply:
        return Reply(list(self._statements.current(request.now)), "revocations")

    def _since(self, request: CallRequest) -> Reply:
        # The list, unless the caller says that it holds the same.
        self._statements.held_lists.record(request.caller, request.binary(1), request.now)
        return Reply(list(self._statements.revocations_for(request.caller, request.now)), "revocations")

    def _update(self, request: CallRequest) -> Reply:
        with refusals_answered():
            newer = self._statements.update(request.binary(1), request.now)
        return _update_reply(newer, request)

    def _update_tree(self, request: CallRequest) -> Steps:
        with refusals_answered():
            newer = yield from self._statements.take_tree(request.binary(1), request.binary(2), request.now)
        return _update_reply(newer, request)

    def _entries(self, request: CallRequest) -> Reply:
        if not request.caller.is_own_master:
            raise Refused("only another master of this domain may call this")
        return Reply(self._statements.tree_entries, "entries")

    def _proofs(self, request: CallRequest) -> Reply:
        return Reply(self._statements.proofs(request.binaries(1)), "proofs")

    def _query(self, request: CallRequest) -> Steps:
        # RFC 9770: what pertains to the caller, and all entries for an administrator.
        caller = request.caller
        if caller.may(Right.ADMIN, self._master):
            entries = self._statements.revoked()
        else:
            keys = (key for kind in Kind for key in self._registry.keys_of(caller.name, kind))
            names = [name for key in keys if (name := key.removesuffix("/"))]
            entries = yield from self._statements.pertaining(caller, names)
        requester = caller.thumbprint + caller.name.encode()
        with refusals_answered():
            answer = self._queries.answer(requester, entries, request.binary(1))
        return Reply(answer, "revocations")


def _update_reply(newer: bool, request: CallRequest) -> Reply:
    if not newer:
        return Reply(0, "not newer than the list in force")
    changed = RevocationsChanged(request.caller.identity)
    return Reply(1, "revocations updated", events=(changed,))


MAX_DOMAIN: Final = 255  # characters


class DomainCalls:
    def __init__(self, statements: TrustState) -> None:
        self._statements = statements

    def methods(self) -> Methods:
        domain, digest = arg.text("domain"), arg.binary("digest")
        entries = arg.binaries("entries", PROOF_LIMIT)
        return {
            DOMAINS: Method((digest,), b"", self._domains),
            UPDATE_DOMAINS: Method((arg.binary("list"),), 0, self._update),
            FOREIGN_REVOCATIONS: Method((domain, digest), [], self._revocations),
            FOREIGN_PROOFS: Method((domain, entries), [], self._proofs),
        }

    def _domains(self, request: CallRequest) -> Reply:
        domains = self._statements.domains
        held = request.binary(1) == domains.digest()
        return Reply(b"" if held else domains.anchors.data, "domains")

    def _update(self, request: CallRequest) -> Reply:
        with refusals_answered():
            newer = self._statements.update_domains(request.binary(1))
        if not newer:
            return Reply(0, "not newer than the list in force")
        changed = DomainsChanged(request.caller.identity)
        return Reply(1, "domains updated", events=(changed,))

    def _revocations(self, request: CallRequest) -> Reply:
        word = self._statements.domains.word(self._listed(request))
        held = request.binary(2) == word.digest()
        answer = [b"" if held else word.revocations, word.timestamp, list(word.chain)]
        return Reply(answer, "revocations")

    def _proofs(self, request: CallRequest) -> Reply:
        domain = self._listed(request)
        entries = request.binaries(2)
        return Reply(self._statements.domains.proofs(domain, entries), "proofs")

    def _listed(self, request: CallRequest) -> str:
        domain = request.text(1)[:MAX_DOMAIN]
        if self._statements.domains.anchors.listed_domain(domain) is None:
            raise Refused(f"domain {domain!a} is not listed here")
        return domain


WATCH_GRANTS: Final = "rossec.watchGrants"
DEPOSIT_LIMIT: Final = 64  # grants in one call
STATES_LIMIT: Final = 256
KNOWN_LIMIT: Final = 256  # ids that a node names
_HOLDER_SIZE: Final = 32
_BATCH: Final = 8  # verifications, a millisecond, between two yields


class DepositCalls:
    # Nothing here is trusted for rights: a node verifies what it fetches.
    def __init__(self, statements: TrustState, deposits: Deposits) -> None:
        self._statements = statements
        self._deposits = deposits

    def methods(self) -> Methods:
        known = arg.binary("known")
        return {
            "rossec.depositGrants": Method((arg.binaries("grants", DEPOSIT_LIMIT),), [], self._deposit),
            "rossec.deliveryStates": Method((arg.binaries("grants", STATES_LIMIT),), [], self._states),
            "rossec.fetchGrants": Method((known,), {}, self._fetch),
            WATCH_GRANTS: Method((known,), {}, self._fetch),
        }

    def _deposit(self, request: CallRequest) -> Steps:
        # 1. Verify in turns, as each costs a signature.
        verified: list[tuple[bytes, Grant | HintedError]] = []
        for number, data in enumerate(request.binaries(1), 1):
            try:
                verified.append((data, self._deposits.verify(data, request.now)))
            except HintedError as error:
                verified.append((data, error))
            if not number % _BATCH:
                yield
        # 2. Take effect in one step, after all was made durable.
        self._deposits.drop_ended(request.now, self._statements.revoked())
        with refusals_answered():
            reasons = self._deposits.add(verified)
        # 3. Notify the holders.
        accepted = zip(verified, reasons, strict=True)
        holders = [g.holder for (_, g), reason in accepted if isinstance(g, Grant) and not reason]
        event = GrantsDeposited(request.caller.identity, frozenset(holders), len(holders))
        refused = len(reasons) - len(holders)
        status = f"{len(holders)} grants deposited" + (f", {refused} refused" if refused else "")
        return Reply(reasons, status, events=(event,) if holders else ())

    def _fetch(self, request: CallRequest) -> Reply:
        known = frozenset(_split(request.binary(1), ID_SIZE, KNOWN_LIMIT))
        found = self._deposits.missing(
            request.caller.thumbprint, known, request.now, self._statements.revoked()
        )
        return Reply({"grants": found.grants, "more": found.more}, "grants")

    def _states(self, request: CallRequest) -> Reply:
        entries = request.binaries(1)
        if any(len(entry) != ID_SIZE + _HOLDER_SIZE for entry in entries):
            raise Refused("a grant is named by its id and the thumbprint of its holder's key")
        self._deposits.drop_ended(request.now, self._statements.revoked())
        return Reply([self._state(entry).value for entry in entries], "states")

    def _state(self, entry: bytes) -> DeliveryState:
        grant_id, holder = entry[:ID_SIZE], entry[ID_SIZE:]
        if self._statements.has_presented(holder, grant_id):
            return DeliveryState.HELD
        return self._deposits.state(grant_id)


def is_empty(answer: object) -> bool:
    match answer:
        case [1, _, {"grants": []}]:
            return True
        case _:
            return False


def _split(value: bytes, size: int, most: int) -> list[bytes]:
    if len(value) % size or len(value) > size * most:
        raise Refused(f"expected at most {most} ids of {size} bytes, one after the other")
    return [value[at : at + size] for at in range(0, len(value), size)]


_DIGEST: Final = 32
_PENDING: Final = 0


class RenewalCalls:
    # A node that has no answer yet is told so with the code 0 of ROS, a failure that is no fault of
    # the call: it asks again soon. The service that answers is the authority's own node.
    def __init__(self, statements: TrustState) -> None:
        self._statements = statements

    def methods(self) -> Methods:
        return {
            RENEW_IDENTITY: Method((arg.binary("request"),), b"", self._renew),
            WATCH_RENEWALS: Method((arg.number("locked"),), {}, self._offer),
            SETTLE_RENEWALS: Method((_settlements,), 0, self._settle),
        }

    def _renew(self, request: CallRequest) -> Reply:
        with refusals_answered():
            found = self._statements.renew_identity(request.caller, request.binary(1), request.now)
        if not found.bundle:
            return Reply(b"", f"rossec: {found.status}", _PENDING)
        return Reply(found.bundle, found.status)

    def _offer(self, request: CallRequest) -> Reply:
        renewals = self._statements.identities
        found = renewals.offer(request.now, locked=request.arguments[1] != 0)
        return Reply({"renewals": found.requests, "waiting": found.waiting}, "renewals")

    def _settle(self, request: CallRequest) -> Steps:
        settled = 0
        answers = request.arguments[1]
        for each in answers if isinstance(answers, list) else ():
            settled += self._statements.identities.settle([each], request.now, self._statements.check)
            yield
        done = Administered(request.caller.identity, f"renewed or refused {settled} identities")
        return Reply(settled, "settled", events=(done,) if settled else ())


def has_no_renewal(answer: object) -> bool:
    match answer:
        case [1, _, {"renewals": []}]:
            return True
        case _:
            return False


def _settlements(value: object, _caller: str) -> list[Settlement]:
    if not isinstance(value, list) or len(value) > OFFER_LIMIT:
        raise ArgumentRefused(f"ERROR: parameter [answers] must be a list of at most {OFFER_LIMIT}")
    found: list[Settlement] = []
    for each in value:
        match each:
            case [bytes(digest), bytes(bundle), str(reason)] if len(digest) == _DIGEST:
                if bool(bundle) is not bool(reason):
                    found.append(Settlement(digest, bundle, reason))
                    continue
        raise ArgumentRefused("ERROR: parameter [answers] has an entry of another form")
    return found


STANDING: Final = "rossec.revocationStanding"
DENIALS: Final = "rossec.recentDenials"
MAX_LACKING: Final = 64  # names in one answer


class AuthorityCalls:
    """What the authority's own node asks for a person: how far a list has come, who was denied.

    Times are given as seconds ago: the clocks of two hosts may differ, and XML-RPC's integers end
    in 2038.
    """

    def __init__(
        self, statements: TrustState, denials: RecentDenials, connected: Callable[[], Iterable[CertifiedPeer]]
    ) -> None:
        self._statements = statements
        self._denials = denials
        self._connected = connected

    def methods(self) -> Methods:
        return {STANDING: Method((), {}, self._standing), DENIALS: Method((), [], self._recent_denials)}

    def _standing(self, request: CallRequest) -> Reply:
        key = request.caller.thumbprint  # the authority has signed the list and needs none
        own = (peer for peer in self._connected() if not is_alias(peer.name))
        nodes = [peer for peer in own if peer.thumbprint != key]
        found = self._statements.standing(nodes, request.now)
        epoch, seq = self._statements.list_number
        answer = {
            "list": f"{epoch}.{seq}",
            "nodes": found.nodes,
            "holding": found.holding,
            "lacking": list(found.lacking[:MAX_LACKING]),
        }
        return Reply(answer, "standing of the revocation list")

    def _recent_denials(self, request: CallRequest) -> Reply:
        answer = [
            [max(0, request.now - denial.at), denial.node, int(denial.right), denial.name]
            for denial in self._denials.newest_first(request.now)
        ]
        return Reply(answer, "denials of the last day")
