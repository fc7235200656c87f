"""What a person approves, as a statement whose digest a passkey signs. Pure.

One statement has one encoding (deterministic CBOR), and one id that is used once: a signature is
for one act. Each kind says all that the act gives away, directly or as the SHA-256 of a payload
that is kept with the approval (`docs/spec/approvals.md`).
"""

from collections.abc import Callable, Mapping
from enum import IntEnum
from hashlib import sha256
from typing import Final, NamedTuple, Self, TypeAlias

from ca.encoding import Value, decode, encode, is_number
from ca.errors import ApprovalRefused, EncodingError
from ca.names import MASTER, is_master_name

VERSION: Final = "rossec-approval-v1"
LIFETIME: Final = 300  # seconds that a person has
ID_SIZE: Final = 16
MAX_STATEMENT: Final = 4096
MAX_CREDENTIAL: Final = 1023  # Web Authentication section 4, "Credential ID"
MAX_PAYLOAD: Final = 1024 * 1024
_DIGEST_SIZE: Final = 32
_MAX_TEXT: Final = 1024  # bytes of UTF-8
_HINT: Final = "ask again: the statement may come from another version of rossec"


class StatementKind(IntEnum):
    """What is approved. `FOREIGN_DOMAIN` is reserved: nothing asks for it yet."""

    # Numbers, and orders of fields, never get another meaning: the record is verified by them for ever.
    ENROLL = 1
    GRANT = 2
    POLICY = 3
    DELEGATE = 4
    INTERMEDIATE = 5
    PASSKEY = 6
    INVITATION = 7
    FOREIGN_DOMAIN = 8
    REVOKE_MASTER = 9


class Enroll(NamedTuple):
    """An identity for a node; `csr` is the digest of its request, `key` its thumbprint."""

    csr: bytes
    name: str
    key: bytes
    wildcard: bool
    lifetime: int  # seconds
    replaces: bool  # the name's other key, which is revoked


class GrantStatement(NamedTuple):
    """An answer to the request with the id `request`; `payload`: digest of what will be signed."""

    request: bytes
    payload: bytes


class PolicyChange(NamedTuple):
    """A policy file put in force, by digests."""

    old: bytes  # of the file before; zeros: none
    new: bytes
    effect: bytes  # of the grants that it makes and revokes (`rossec.authority.policyfile`)


class DelegateStatement(NamedTuple):
    """Leave for the master with the key `holder` to renew grants, by `max_ttl` seconds each."""

    holder: bytes
    lifetime: int
    max_ttl: int


class IntermediateStatement(NamedTuple):
    """An intermediate, by the digest of its request; `enrolls`: new nodes, not only known ones."""

    csr: bytes
    enrolls: bool
    lifetime: int


class NewPasskey(NamedTuple):
    """Another passkey: its credential id, the digest of its COSE key, and its name."""

    credential: bytes
    key: bytes
    name: str


class Invitation(NamedTuple):
    """A join code for `uses` nodes whose names `pattern` covers, until this time."""

    pattern: str
    uses: int
    until: int
    wildcard: bool


class ForeignDomainStatement(NamedTuple):
    digest: bytes


class RevokeMaster(NamedTuple):
    """The revocation of a master's keys, which ends all that needs this master."""

    reason: str
    master: str = MASTER


What: TypeAlias = (
    Enroll
    | GrantStatement
    | PolicyChange
    | DelegateStatement
    | IntermediateStatement
    | NewPasskey
    | Invitation
    | ForeignDomainStatement
    | RevokeMaster
)


def _is_text(value: object) -> bool:
    try:
        return isinstance(value, str) and len(value.encode()) <= _MAX_TEXT
    except UnicodeEncodeError:
        return False


def _is_name(value: object) -> bool:
    return _is_text(value) and value != ""


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


def _is_id(value: object) -> bool:
    return isinstance(value, bytes) and len(value) == ID_SIZE


def _is_digest(value: object) -> bool:
    return isinstance(value, bytes) and len(value) == _DIGEST_SIZE


def _is_credential(value: object) -> bool:
    return isinstance(value, bytes) and 0 < len(value) <= MAX_CREDENTIAL


def _is_master(value: object) -> bool:
    return isinstance(value, str) and is_master_name(value)


class _Form(NamedTuple):
    build: Callable[..., What]
    fields: tuple[Callable[[object], bool], ...]  # checks
    subject: int | None = None  # which field names what it is about
    payload: int | None = None  # which one is the digest of a payload
    default: str | None = None  # a last field that equals it is left out


_FORMS: Final[Mapping[StatementKind, _Form]] = {
    StatementKind.ENROLL: _Form(
        Enroll, (_is_digest, _is_name, _is_digest, _is_flag, is_number, _is_flag), 0, 0
    ),
    StatementKind.GRANT: _Form(GrantStatement, (_is_id, _is_digest), 0, 1),
    StatementKind.POLICY: _Form(PolicyChange, (_is_digest, _is_digest, _is_digest), 1, 1),
    StatementKind.DELEGATE: _Form(DelegateStatement, (_is_digest, is_number, is_number), 0),
    StatementKind.INTERMEDIATE: _Form(IntermediateStatement, (_is_digest, _is_flag, is_number), 0, 0),
    StatementKind.PASSKEY: _Form(NewPasskey, (_is_credential, _is_digest, _is_name), 0),
    StatementKind.INVITATION: _Form(Invitation, (_is_name, is_number, is_number, _is_flag)),
    StatementKind.FOREIGN_DOMAIN: _Form(ForeignDomainStatement, (_is_digest,), 0),
    StatementKind.REVOKE_MASTER: _Form(RevokeMaster, (_is_text, _is_master), default=MASTER),
}


class Statement(NamedTuple):
    """One act, to be approved between `made` and `until`; the log of the record had this head."""

    kind: StatementKind
    id: bytes
    domain: str
    made: int
    until: int
    log_size: int
    log_root: bytes
    what: What

    def to_bytes(self) -> bytes:
        _check(self)
        # The head of the log: what was approved before a restore says nothing about the record after it.
        log: Value = [self.log_size, self.log_root]
        head: list[Value] = [VERSION, int(self.kind), self.id, self.domain, self.made, self.until]
        fields: list[Value] = [*self.what]
        return encode([*head, log, fields[:-1] if fields[-1] == _FORMS[self.kind].default else fields])

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        try:
            value = decode(data, limit=MAX_STATEMENT)
        except EncodingError as error:
            raise ApprovalRefused(f"this is not a statement: {error}", _HINT) from error
        match value:
            case [
                str(version),
                int(kind),
                bytes(id_),
                str(domain),
                int(made),
                int(until),
                [int(size), bytes(root)],
                [*fields],
            ] if version == VERSION:
                if isinstance(kind, bool) or kind not in _FORMS:  # True equals 1, and is encoded otherwise
                    raise ApprovalRefused("a statement of an unknown kind", _HINT)
                what = _what(StatementKind(kind), fields)
                found = cls(StatementKind(kind), id_, domain, made, until, size, root, what)
                _check(found)
                return found
            case _:
                raise ApprovalRefused("this is not a statement of a known form", _HINT)

    @property
    def challenge(self) -> bytes:
        return sha256(self.to_bytes()).digest()

    @property
    def subject(self) -> bytes:
        return self._field(_FORMS[self.kind].subject) or b""

    def check_payload(self, payload: bytes) -> None:
        """Return if `payload` is the one whose digest was approved; without a digest, it is empty."""
        digest = self._field(_FORMS[self.kind].payload)
        if len(payload) > MAX_PAYLOAD:
            raise ApprovalRefused("the payload of the approval is too large", "approve less")
        if payload != b"" if digest is None else sha256(payload).digest() != digest:
            raise ApprovalRefused(
                "what was approved is not what was shown", "look at it again, and approve that"
            )

    def _field(self, position: int | None) -> bytes | None:
        if position is None:
            return None
        found = tuple(self.what)[position]
        assert isinstance(found, bytes)  # noqa: S101 - `_check`
        return found


def _what(kind: StatementKind, fields: list[Value]) -> What:
    form = _FORMS[kind]
    if form.default is not None and len(fields) == len(form.fields) - 1:
        fields = [*fields, form.default]
    elif len(fields) != len(form.fields) or (fields and fields[-1] == form.default):
        raise ApprovalRefused(f"a statement of kind {kind} with {len(fields)} fields", _HINT)
    return form.build(*fields)


def _check(statement: Statement) -> None:
    form = _FORMS[statement.kind]
    if type(statement.what) is not form.build:
        raise ApprovalRefused(f"a statement of kind {statement.kind} about another", _HINT)
    head = (
        (_is_id, statement.id),
        (_is_name, statement.domain),
        (_is_digest, statement.log_root),
        *((is_number, each) for each in (statement.made, statement.until, statement.log_size)),
    )
    if not all(check(field) for check, field in (*zip(form.fields, statement.what, strict=True), *head)):
        raise ApprovalRefused("a field of the statement is not of its form", _HINT)
    if not statement.made < statement.until <= statement.made + LIFETIME:
        raise ApprovalRefused(f"a statement is valid for at most {LIFETIME} seconds", _HINT)
