"""The calls about the authority's statements: grants, delegations, revocations. Pure.

Lists and delegations carry the authority's signature, so any authenticated node may deliver one.
Answers to RFC 9770 queries contain what pertains to a node, and all entries for an administrator.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from ca.errors import HintedError
from grants.model import Right
from rossec.master.api import arguments as arg
from rossec.master.api.methods import (
    Administered,
    CallRequest,
    GrantsPresented,
    Method,
    Methods,
    Reply,
    RevocationsChanged,
    Steps,
)
from rossec.master.rights.caller import Refused
from rossec.master.rights.deposits import Deposits
from rossec.master.rights.statements import TrustState
from rossec.master.rights.trl import RevocationQueries
from rossec.master.state.registry import Kind, Registry

PRESENT_LIMIT: Final = 64
RENEW_LIMIT: Final = 16
PROOF_LIMIT: Final = 64


class StatementCalls:
    """Handlers over one `TrustState`.

    Args:
        registry: to find the names that a caller is registered for.
        master: the master's own certified name; ADMIN is a right on this name.
        started: when this run of the master began, seconds since the epoch.
        deposits: to record which of them their holders have.
    """

    def __init__(
        self,
        statements: TrustState,
        registry: Registry,
        master: str,
        started: int,
        deposits: Deposits,
    ) -> None:
        self._statements = statements
        self._registry = registry
        self._master = master
        self._queries = RevocationQueries(started)
        self._deposits = deposits

    def methods(self) -> Methods:
        """The entries of the method table."""
        grants = arg.binaries("grants", PRESENT_LIMIT)
        renewed = arg.binaries("grants", RENEW_LIMIT)
        return {
            "rossec.presentGrants": Method((grants,), 0, self._present),
            "rossec.renewGrants": Method((renewed,), [], self._renew),
            "rossec.updateDelegation": Method(
                (arg.binary("delegation"),), 0, self._update_delegation
            ),
            "rossec.revocations": Method((), [], self._revocations),
            "rossec.revocationsSince": Method((arg.binary("digest"),), [], self._since),
            "rossec.updateRevocations": Method((arg.binary("list"),), 0, self._update),
            "rossec.updateRevocationTree": Method(
                (arg.binary("tree"), arg.binary("entries")), 0, self._update_tree
            ),
            "rossec.revocationEntries": Method((), b"", self._entries),
            "rossec.revocationProofs": Method(
                (arg.binaries("entries", PROOF_LIMIT),), [], self._proofs
            ),
            "rossec.trl": Method((arg.binary("query"),), b"", self._query),
        }

    def _present(self, request: CallRequest) -> Steps:
        """In turns: each token costs several signatures, and 64 KiB of CBOR before the first."""
        tokens, reasons = binaries(request.arguments[1]), list[str]()
        for token in tokens:
            reasons += self._statements.present(request.caller, [token], request.now).refused
            yield
        presented = self._statements.present(request.caller, [], request.now)
        self._deposits.presented(request.caller.thumbprint, tokens)
        refused = "; ".join(reasons)
        # No error even if all are refused: a node whose grants have expired keeps its session and
        # presents new ones in it.
        status = f"grants presented, but refused: {refused}" if refused else "grants accepted"
        event = GrantsPresented(request.caller.identity, tuple(reasons))
        return Reply(presented.held, status, events=(event,))

    def _renew(self, request: CallRequest) -> Reply:
        renewed = self._statements.renew(
            request.caller, binaries(request.arguments[1]), request.now
        )
        refused = "; ".join(renewed.refused)
        status = f"grants renewed, but refused: {refused}" if refused else "grants renewed"
        event = GrantsPresented(request.caller.identity, renewed.refused)
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
        """The list, unless the caller says that it holds the same."""
        self._statements.held_lists.record(request.caller, request.binary(1), request.now)
        return Reply(
            list(self._statements.revocations_for(request.caller, request.now)), "revocations"
        )

    def _update(self, request: CallRequest) -> Reply:
        with refusals_answered():
            newer = self._statements.update(request.binary(1), request.now)
        return _update_reply(newer, request)

    def _update_tree(self, request: CallRequest) -> Steps:
        with refusals_answered():
            newer = yield from self._statements.take_tree(
                request.binary(1), request.binary(2), request.now
            )
        return _update_reply(newer, request)

    def _entries(self, request: CallRequest) -> Reply:
        """All entries of the tree in force, which name what was ever revoked: to own masters."""
        if not request.caller.is_own_master:
            raise Refused("only another master of this domain may call this")
        return Reply(self._statements.tree_entries, "entries")

    def _proofs(self, request: CallRequest) -> Reply:
        return Reply(self._statements.proofs(binaries(request.arguments[1])), "proofs")

    def _query(self, request: CallRequest) -> Steps:
        caller = request.caller
        if caller.may(Right.ADMIN, self._master):
            entries = self._statements.revoked()
        else:
            names = self._names_of(caller.name)
            entries = yield from self._statements.pertaining(caller, names)
        requester = caller.thumbprint + caller.name.encode()
        with refusals_answered():
            answer = self._queries.answer(requester, entries, request.binary(1))
        return Reply(answer, "revocations")

    def _names_of(self, node: str) -> list[str]:
        """The names a node is registered for; a subscription to all parameters names none."""
        keys = (key for kind in Kind for key in self._registry.keys_of(node, kind))
        return [name for key in keys if (name := key.removesuffix("/"))]


def _update_reply(newer: bool, request: CallRequest) -> Reply:
    if not newer:
        return Reply(0, "not newer than the list in force")
    changed = RevocationsChanged(request.caller.identity)
    return Reply(1, "revocations updated", events=(changed,))


@contextmanager
def refusals_answered() -> Iterator[None]:
    """Answer with what a statement is refused for."""
    try:
        yield
    except HintedError as error:
        raise Refused(f"{error} ({error.hint})" if error.hint else str(error)) from error


def binaries(value: object) -> Sequence[bytes]:
    """An argument that `arg.binaries` has checked."""
    return [item for item in value if isinstance(item, bytes)] if isinstance(value, list) else []
