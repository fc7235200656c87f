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
from rossec.master.api import methods
from rossec.master.rights import held_grants, revocation_lists
from rossec.master.rights.caller import CertifiedPeer, Refused, refusals_answered
from rossec.master.state import journals, registry

PRESENT_LIMIT: Final = 64
RENEW_LIMIT: Final = 16
PROOF_LIMIT: Final = 64
MAX_DOMAIN: Final = 255  # characters
WATCH_GRANTS: Final = "rossec.watchGrants"
TRUST_STATUS: Final = "rossec.revocationStatus"
DENIALS: Final = "rossec.recentDenials"
DEPOSIT_LIMIT: Final = 64  # grants in one call
STATES_LIMIT: Final = 256
KNOWN_LIMIT: Final = 256  # ids that a node names
_HOLDER_SIZE: Final = 32
_BATCH: Final = 8  # verifications, a millisecond, between two yields
MAX_LACKING: Final = 64  # names in one answer


class StatementCalls:
    """Handlers over one `TrustState`, of a master that began at `started`."""

    # Nothing in a deposit is trusted for rights: a node verifies what it fetches. A node whose renewal has no
    # answer yet is told so with the code 0 of ROS, a failure that is no fault of the call: it asks again
    # soon. Times are given as seconds ago: the clocks of two hosts may differ, and XML-RPC's integers end in
    # 2038.
    def __init__(
        self, tables: methods.MasterTables, started: int, connected: Callable[[], Iterable[CertifiedPeer]]
    ) -> None:
        self._tables = tables
        self._trust = tables.trust
        self._deposits = tables.deposits
        self._queries = revocation_lists.RevocationQueries(started)
        self._connected = connected

    def present(self, request: methods.CallRequest) -> methods.Steps:
        tokens, reasons = request.binaries(1), list[str]()
        for token in tokens:
            reasons += self._trust.present(request.caller, [token], request.now).refused
            yield
        presented = self._trust.present(request.caller, [], request.now)
        self._deposits.presented(request.caller.thumbprint, tokens)
        refused = "; ".join(reasons)
        # No error even if all are refused: a node whose grants have expired keeps its session and
        # presents new ones in it.
        status = f"grants presented, but refused: {refused}" if refused else "grants accepted"
        event = methods.CallerPresentedGrants(request.caller.identity, tuple(reasons))
        return methods.Reply(presented.held, status, events=(event,))

    def renew_grants(self, request: methods.CallRequest) -> methods.Reply:
        renewed = self._trust.renew(request.caller, request.binaries(1), request.now)
        refused = "; ".join(renewed.refused)
        status = f"grants renewed, but refused: {refused}" if refused else "grants renewed"
        event = methods.CallerPresentedGrants(request.caller.identity, renewed.refused)
        return methods.Reply(list(renewed.tokens), status, events=(event,))

    def update_delegation(self, request: methods.CallRequest) -> methods.Reply:
        with refusals_answered():
            newer = self._trust.update_delegation(request.binary(1))
        if not newer:
            return methods.Reply(0, "not newer than the delegation held")
        delivered = methods.Administered(request.caller.identity, "delivered a delegation to renew grants")
        return methods.Reply(1, "delegated", events=(delivered,))

    def revocations(self, request: methods.CallRequest) -> methods.Reply:
        return methods.Reply(list(self._trust.current(request.now)), "revocations")

    def revocations_since(self, request: methods.CallRequest) -> methods.Reply:
        # The list, unless the caller says that it holds the same.
        self._trust.held_lists.record(request.caller, request.binary(1), request.now)
        return methods.Reply(list(self._trust.revocations_for(request.caller, request.now)), "revocations")

    def update_revocations(self, request: methods.CallRequest) -> methods.Reply:
        with refusals_answered():
            newer = self._trust.update(request.binary(1), request.now)
        return _update_reply(newer, request)

    def update_tree(self, request: methods.CallRequest) -> methods.Steps:
        with refusals_answered():
            newer = yield from self._trust.take_tree(request.binary(1), request.binary(2), request.now)
        return _update_reply(newer, request)

    def tree_entries(self, request: methods.CallRequest) -> methods.Reply:
        if not request.caller.is_own_master:
            raise Refused("only another master of this domain may call this")
        return methods.Reply(self._trust.tree_entries, "entries")

    def proofs(self, request: methods.CallRequest) -> methods.Reply:
        return methods.Reply(self._trust.proofs(request.binaries(1)), "proofs")

    def query(self, request: methods.CallRequest) -> methods.Steps:
        # RFC 9770: what pertains to the caller, and all entries for an administrator.
        caller = request.caller
        if caller.may(Right.ADMIN, self._tables.name):
            entries = self._trust.revoked()
        else:
            keys = (key for kind in registry.Kind for key in self._tables.registry.keys_of(caller.name, kind))
            names = [name for key in keys if (name := key.removesuffix("/"))]
            entries = yield from self._trust.pertaining(caller, names)
        requester = caller.thumbprint + caller.name.encode()
        with refusals_answered():
            answer = self._queries.answer(requester, entries, request.binary(1))
        return methods.Reply(answer, "revocations")

    def domains(self, request: methods.CallRequest) -> methods.Reply:
        domains = self._trust.domains
        held = request.binary(1) == domains.digest()
        return methods.Reply(b"" if held else domains.anchors.data, "domains")

    def update_domains(self, request: methods.CallRequest) -> methods.Reply:
        with refusals_answered():
            newer = self._trust.update_domains(request.binary(1))
        if not newer:
            return methods.Reply(0, "not newer than the list in force")
        changed = methods.DomainsChanged(request.caller.identity)
        return methods.Reply(1, "domains updated", events=(changed,))

    def foreign_revocations(self, request: methods.CallRequest) -> methods.Reply:
        word = self._trust.domains.word(self._listed(request))
        held = request.binary(2) == word.digest()
        answer = [b"" if held else word.revocations, word.timestamp, list(word.chain)]
        return methods.Reply(answer, "revocations")

    def foreign_proofs(self, request: methods.CallRequest) -> methods.Reply:
        domain = self._listed(request)
        entries = request.binaries(2)
        return methods.Reply(self._trust.domains.proofs(domain, entries), "proofs")

    def _listed(self, request: methods.CallRequest) -> str:
        domain = request.text(1)[:MAX_DOMAIN]
        if self._trust.domains.anchors.listed_domain(domain) is None:
            raise Refused(f"domain {domain!a} is not listed here")
        return domain

    def deposit(self, request: methods.CallRequest) -> methods.Steps:
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
        self._deposits.drop_ended(request.now, self._trust.revoked())
        with refusals_answered():
            reasons = self._deposits.add(verified)
        # 3. Notify the holders.
        accepted = zip(verified, reasons, strict=True)
        holders = [g.holder for (_, g), reason in accepted if isinstance(g, Grant) and not reason]
        event = methods.GrantsDeposited(request.caller.identity, frozenset(holders), len(holders))
        refused = len(reasons) - len(holders)
        status = f"{len(holders)} grants deposited" + (f", {refused} refused" if refused else "")
        return methods.Reply(reasons, status, events=(event,) if holders else ())

    def fetch(self, request: methods.CallRequest) -> methods.Reply:
        known = frozenset(_split(request.binary(1), journals.ID_SIZE, KNOWN_LIMIT))
        found = self._deposits.missing(request.caller.thumbprint, known, request.now, self._trust.revoked())
        return methods.Reply({"grants": found.grants, "more": found.more}, "grants")

    def delivery_states(self, request: methods.CallRequest) -> methods.Reply:
        entries = request.binaries(1)
        if any(len(entry) != journals.ID_SIZE + _HOLDER_SIZE for entry in entries):
            raise Refused("a grant is named by its id and the thumbprint of its holder's key")
        self._deposits.drop_ended(request.now, self._trust.revoked())
        return methods.Reply([self._state(entry).value for entry in entries], "states")

    def _state(self, entry: bytes) -> held_grants.DeliveryState:
        grant_id, holder = entry[: journals.ID_SIZE], entry[journals.ID_SIZE :]
        if self._trust.has_presented(holder, grant_id):
            return held_grants.DeliveryState.HELD
        return self._deposits.state(grant_id)

    def renew_identity(self, request: methods.CallRequest) -> methods.Reply:
        with refusals_answered():
            found = self._trust.renew_identity(request.caller, request.binary(1), request.now)
        if not found.bundle:
            return methods.Reply(b"", f"rossec: {found.status}", 0)
        return methods.Reply(found.bundle, found.status)

    def offer_renewals(self, request: methods.CallRequest) -> methods.Reply:
        renewals = self._trust.identities
        found = renewals.offer(request.now, locked=request.arguments[1] != 0)
        return methods.Reply({"renewals": found.requests, "waiting": found.waiting}, "renewals")

    def settle_renewals(self, request: methods.CallRequest) -> methods.Steps:
        settled = 0
        answers = request.arguments[1]
        for each in answers if isinstance(answers, list) else ():
            settled += self._trust.identities.settle([each], request.now, self._trust.check)
            yield
        done = methods.Administered(request.caller.identity, f"renewed or refused {settled} identities")
        return methods.Reply(settled, "settled", events=(done,) if settled else ())

    def trust_status(self, request: methods.CallRequest) -> methods.Reply:
        key = request.caller.thumbprint  # the authority has signed the list and needs none
        own = (peer for peer in self._connected() if not is_alias(peer.name))
        nodes = [peer for peer in own if peer.thumbprint != key]
        found = self._trust.trust_status(nodes, request.now)
        epoch, seq = self._trust.list_number
        answer = {
            "list": f"{epoch}.{seq}",
            "nodes": found.nodes,
            "holding": found.holding,
            "lacking": list(found.lacking[:MAX_LACKING]),
        }
        return methods.Reply(answer, "trust status of the revocation list")

    def recent_denials(self, request: methods.CallRequest) -> methods.Reply:
        answer = [
            [max(0, request.now - denial.at), denial.node, int(denial.right), denial.name]
            for denial in self._tables.recent_denials.newest_first(request.now)
        ]
        return methods.Reply(answer, "denials of the last day")


def _update_reply(newer: bool, request: methods.CallRequest) -> methods.Reply:
    if not newer:
        return methods.Reply(0, "not newer than the list in force")
    changed = methods.RevocationsChanged(request.caller.identity)
    return methods.Reply(1, "revocations updated", events=(changed,))


def _split(value: bytes, size: int, most: int) -> list[bytes]:
    if len(value) % size or len(value) > size * most:
        raise Refused(f"expected at most {most} ids of {size} bytes, one after the other")
    return [value[at : at + size] for at in range(0, len(value), size)]
