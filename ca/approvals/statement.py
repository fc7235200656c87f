"""What a person approves, as a statement whose digest a passkey signs. Pure.

One statement has one encoding (deterministic CBOR), and one id that is used once: a signature is
for one act. Each kind says all that the act gives away, directly or as the SHA-256 of a payload
that is kept with the approval. Numbers of kinds and orders of fields are never used again for
another meaning: the record is verified by them for ever (`docs/spec/approvals.md`).
"""

from collections.abc import Callable, Mapping
from enum import IntEnum
from hashlib import sha256
from typing import Final, NamedTuple, Self, TypeAlias

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, StatementRefused
from ca.names import MASTER, is_master_name

VERSION: Final = "rossec-approval-v1"
LIFETIME: Final = 300  # seconds that a person has
ID_SIZE: Final = 16
MAX_STATEMENT: Final = 4096
MAX_CREDENTIAL: Final = 1023  # Web Authentication section 4, "Credential ID"
MAX_PAYLOAD: Final = 1024 * 1024
_DIGEST_SIZE: Final = 32
_MAX_TEXT: Final = 1024  # bytes of UTF-8
_INT_LIMIT: Final = 1 << 53
_HINT: Final = "ask again: the statement may come from another version of rossec"


class Kind(IntEnum):
    """What is approved. `FOREIGN_DOMAIN` is reserved: nothing asks for it yet."""

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


class Grant(NamedTuple):
    """An answer to the request with the id `request`; `payload`: digest of what will be signed."""

    request: bytes
    payload: bytes


class PolicyChange(NamedTuple):
    """A policy file put in force: digests of the one before (zeros: none) and of the new one.

    `effect`: digest of the grants that it makes and revokes (`rossec.authority.policy_plan`).
    """

    old: bytes
    new: bytes
    effect: bytes


class Delegate(NamedTuple):
    """Leave for the master with the key `holder` to renew grants, by `max_ttl` seconds each."""

    holder: bytes
    lifetime: int
    max_ttl: int


class Intermediate(NamedTuple):
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


class ForeignDomain(NamedTuple):
    """Reserved for trust in another domain."""

    digest: bytes


class RevokeMaster(NamedTuple):
    """The revocation of a master's keys, which ends all that needs this master."""

    reason: str
    master: str = MASTER


What: TypeAlias = (
    Enroll | Grant | PolicyChange | Delegate | Intermediate | NewPasskey | Invitation
    | ForeignDomain | RevokeMaster
)  # fmt: skip


def _is_text(value: object) -> bool:
    try:
        return isinstance(value, str) and len(value.encode()) <= _MAX_TEXT
    except UnicodeEncodeError:
        return False


def _is_name(value: object) -> bool:
    return _is_text(value) and value != ""


def _is_number(value: object) -> bool:
    return type(value) is int and 0 <= value < _INT_LIMIT


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
    """The form of a kind: its fields' checks, which field names what it is about, and which
    is the digest of a payload.

    A last field that equals `default` is left out, as before there was one.
    """

    build: Callable[..., What]
    fields: tuple[Callable[[object], bool], ...]
    subject: int | None = None
    payload: int | None = None
    default: str | None = None


_FORMS: Final[Mapping[Kind, _Form]] = {
    Kind.ENROLL: _Form(
        Enroll, (_is_digest, _is_name, _is_digest, _is_flag, _is_number, _is_flag), 0, 0
    ),
    Kind.GRANT: _Form(Grant, (_is_id, _is_digest), 0, 1),
    Kind.POLICY: _Form(PolicyChange, (_is_digest, _is_digest, _is_digest), 1, 1),
    Kind.DELEGATE: _Form(Delegate, (_is_digest, _is_number, _is_number), 0),
    Kind.INTERMEDIATE: _Form(Intermediate, (_is_digest, _is_flag, _is_number), 0, 0),
    Kind.PASSKEY: _Form(NewPasskey, (_is_credential, _is_digest, _is_name), 0),
    Kind.INVITATION: _Form(Invitation, (_is_name, _is_number, _is_number, _is_flag)),
    Kind.FOREIGN_DOMAIN: _Form(ForeignDomain, (_is_digest,), 0),
    Kind.REVOKE_MASTER: _Form(RevokeMaster, (_is_text, _is_master), default=MASTER),
}


class Statement(NamedTuple):
    """One act, to be approved between `made` and `until`; the log of the record had this head."""

    kind: Kind
    id: bytes
    domain: str
    made: int
    until: int
    log_size: int
    log_root: bytes
    what: What

    def to_bytes(self) -> bytes:
        """Its one encoding.

        Raises:
            StatementRefused: a field is not of its form.
        """
        _check(self)
        log: Value = [self.log_size, self.log_root]
        head: list[Value] = [VERSION, int(self.kind), self.id, self.domain, self.made, self.until]
        return encode([*head, log, _fields(self.kind, self.what)])

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read a statement.

        Raises:
            StatementRefused: too long, or anything but exactly the encoding of a statement.
        """
        try:
            value = decode(data, limit=MAX_STATEMENT)
        except EncodingError as error:
            raise StatementRefused(f"this is not a statement: {error}", _HINT) from error
        match value:
            case [str(version), int(kind), bytes(id_), str(domain), int(made), int(until),
                  [int(size), bytes(root)], [*fields]] if version == VERSION:  # fmt: skip
                what = _what(_kind(kind), fields)
                found = cls(_kind(kind), id_, domain, made, until, size, root, what)
                _check(found)
                return found
            case _:
                raise StatementRefused("this is not a statement of a known form", _HINT)

    @property
    def challenge(self) -> bytes:
        """The 32 bytes that the passkey signs."""
        return sha256(self.to_bytes()).digest()

    @property
    def subject(self) -> bytes:
        """What the act is about, such as the request it answers; may be empty."""
        return self._field(_FORMS[self.kind].subject) or b""

    def check_payload(self, payload: bytes) -> None:
        """Return if `payload` is the one whose digest was approved; without a digest, it is empty.

        Raises:
            StatementRefused: it is another.
        """
        digest = self._field(_FORMS[self.kind].payload)
        if len(payload) > MAX_PAYLOAD:
            raise StatementRefused("the payload of the approval is too large", "approve less")
        if payload != b"" if digest is None else sha256(payload).digest() != digest:
            raise StatementRefused(
                "what was approved is not what was shown", "look at it again, and approve that"
            )

    def _field(self, position: int | None) -> bytes | None:
        if position is None:
            return None
        found = tuple(self.what)[position]
        assert isinstance(found, bytes)  # noqa: S101 - `_check`
        return found


def _kind(number: int) -> Kind:
    if isinstance(number, bool) or number not in _FORMS:  # True equals 1, and is encoded otherwise
        raise StatementRefused("a statement of an unknown kind", _HINT)
    return Kind(number)


def _what(kind: Kind, fields: list[Value]) -> What:
    form = _FORMS[kind]
    if form.default is not None and len(fields) == len(form.fields) - 1:
        fields = [*fields, form.default]
    elif len(fields) != len(form.fields) or (fields and fields[-1] == form.default):
        raise StatementRefused(f"a statement of kind {kind} with {len(fields)} fields", _HINT)
    return form.build(*fields)


def _fields(kind: Kind, what: What) -> list[Value]:
    fields: list[Value] = list(what)
    return fields[:-1] if fields[-1] == _FORMS[kind].default else fields


def _check(statement: Statement) -> None:
    form = _FORMS[statement.kind]
    if type(statement.what) is not form.build:
        raise StatementRefused(f"a statement of kind {statement.kind} about another", _HINT)
    fields = (*zip(form.fields, statement.what, strict=True), *_head_of(statement))
    if not all(is_right(field) for is_right, field in fields):
        raise StatementRefused("a field of the statement is not of its form", _HINT)
    if not statement.made < statement.until <= statement.made + LIFETIME:
        raise StatementRefused(f"a statement is valid for at most {LIFETIME} seconds", _HINT)


def _head_of(statement: Statement) -> tuple[tuple[Callable[[object], bool], object], ...]:
    return (
        (_is_id, statement.id),
        (_is_name, statement.domain),
        (_is_number, statement.made),
        (_is_number, statement.until),
        (_is_number, statement.log_size),
        (_is_digest, statement.log_root),
    )
