"""Approvals for tests: a phone that is registered, statements, and its touch on them."""

from ca.approvals.passkeys import Approval, Assertion, Passkey
from ca.approvals.statement import (
    LIFETIME,
    DelegateStatement,
    Enroll,
    ForeignDomainStatement,
    GrantStatement,
    IntermediateStatement,
    Invitation,
    NewPasskey,
    PolicyChange,
    RevokeMaster,
    Statement,
    StatementKind,
    What,
)
from ca.store.record import Store
from tests.support import passkeys

NOW = 1_800_000_000
DIGESTS = [bytes([number]) * 32 for number in range(9)]
DEVICE = passkeys.Passkey()
WHATS: dict[StatementKind, What] = {
    StatementKind.ENROLL: Enroll(DIGESTS[1], "/robot", DIGESTS[2], wildcard=False, lifetime=9, replaces=True),
    StatementKind.GRANT: GrantStatement(b"r" * 16, DIGESTS[3]),
    StatementKind.POLICY: PolicyChange(DIGESTS[0], DIGESTS[4], DIGESTS[8]),
    StatementKind.DELEGATE: DelegateStatement(DIGESTS[5], 86400, 3600),
    StatementKind.INTERMEDIATE: IntermediateStatement(DIGESTS[6], enrolls=True, lifetime=86400),
    StatementKind.PASSKEY: NewPasskey(b"credential", DIGESTS[7], "Ann's phone"),
    StatementKind.INVITATION: Invitation("/fleet/*", 30, NOW + 3600, wildcard=False),
    StatementKind.FOREIGN_DOMAIN: ForeignDomainStatement(DIGESTS[8]),
    StatementKind.REVOKE_MASTER: RevokeMaster("stolen"),
}


def registered(device: passkeys.Passkey, name: str = "Ann's phone", at: int = NOW) -> Passkey:
    """A passkey as it is recorded when the terminal adds it."""
    return Passkey(device.id, name, device.cose_key, bytes(16), device.rp_id, device.origin, b"", at)


PASSKEY = registered(DEVICE)


def state(
    what: What,
    *,
    id: bytes = b"i" * 16,  # noqa: A002
    store: Store | None = None,
    made: int = NOW,
) -> Statement:
    """A statement about the record as it is now."""
    kind = next(kind for kind, known in WHATS.items() if type(known) is type(what))
    head = None if store is None else store.log.head(made)
    size, root = (0, bytes(32)) if head is None else (head.size, head.root)
    return Statement(kind, id, "home", made, made + LIFETIME, size, root, what)


def touch(
    statement: Statement, payload: bytes = b"", device: passkeys.Passkey = DEVICE, at: int = NOW
) -> Approval:
    """The approval of a statement by a device."""
    return Approval.of(statement, payload, Assertion(*device.sign(statement.challenge)), at)


def approve(
    store: Store,
    what: What = WHATS[StatementKind.DELEGATE],
    payload: bytes = b"",
    *,
    id: bytes = b"i" * 16,  # noqa: A002
    device: passkeys.Passkey = DEVICE,
    at: int = NOW,
) -> Approval:
    """A touch on a statement about `store` as it is now."""
    return touch(state(what, id=id, store=store, made=at), payload, device, at)
