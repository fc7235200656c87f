"""What the console asks of the authority's service, and the records of the answers. Pure.

`Operations` is all that it can ask; frames and refusals are those of `keyservice.messages`. Nothing
in it signs what was not approved: `prepare` makes a statement, `approve` verifies a passkey's
signature over its digest and only then acts. What only takes away (`deny_*`, `revoke_*`, `end_*`,
`remove_phone`) needs none.

A record is the list of its fields. The annotations say what may come; everything else is refused,
also an int where a bool belongs. Times are seconds since the epoch, durations seconds; ids, digests
and keys (COSE thumbprints) are bytes. Texts of nodes are as the nodes wrote them: whoever shows
them escapes them.
"""

import inspect
import ipaddress
import re
from collections.abc import Callable, Coroutine, Iterable, Mapping
from contextlib import suppress
from itertools import chain
from types import NoneType, UnionType
from typing import Any, Final, NamedTuple, TypeVar, assert_never, get_args, get_origin, get_type_hints
from urllib.parse import urlsplit

from ca.approvals import statement as kinds
from ca.approvals.statement import Statement
from ca.encoding import Value, decode
from ca.errors import ApprovalRefused, EncodingError
from ca.names import MASTER
from grants import document, model
from grants.errors import GrantError
from rossec import clock, files, peer_limits
from rossec.authority.keyservice import messages
from rossec.errors import KeyMessageRefused, KeyServiceRefused

# mypy: disable-error-code="empty-body"


LOOKER: Final = "look"
"""Everybody who may only look, where they share one place."""

_PHONE: Final = "phone "


def of_phone(name: str) -> str:
    return f"{_PHONE}{name}"


def of_looker(session: bytes) -> str:
    return f"{LOOKER} {session.hex()}"


def rank(owner: str) -> int:
    return int(owner.startswith(_PHONE))


MAX_ORIGIN: Final = 300
_LABEL: Final = "[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
_DOMAIN: Final = re.compile(rf"{_LABEL}(\.{_LABEL})*")


def check_page(origin: str, rp_id: str) -> None:
    host = _host(origin)
    if host is None:
        raise ApprovalRefused(
            f"{origin[:80]!a} is no address of a console", "https://NAME, or http://localhost"
        )
    is_name = _DOMAIN.fullmatch(rp_id) is not None
    with suppress(ValueError):  # an RP id is a domain (WebAuthn), and 127.0.0.1 has the form of one
        ipaddress.ip_address(rp_id)
        is_name = False
    if not is_name:
        raise ApprovalRefused(f"passkeys cannot belong to {rp_id[:80]!a}", "open the console by a name")
    if host != rp_id and not host.endswith(f".{rp_id}"):
        raise ApprovalRefused(
            f"a page at {host} has no passkeys of {rp_id}", "open the console by its own name"
        )


def _host(origin: str) -> str | None:
    # The host of exactly an origin (RFC 6454), if it is a secure context.
    if len(origin) > MAX_ORIGIN:
        return None
    try:
        parts = urlsplit(origin)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        return None
    shown = host if port is None else f"{host}:{port}"
    if origin != f"{parts.scheme}://{shown}" or not _DOMAIN.fullmatch(host):
        return None
    is_secure = parts.scheme == "https" or (parts.scheme == "http" and host == "localhost")
    return host if is_secure else None


CODE_LIFETIME: Final = 120.0  # seconds, of a code that a terminal shows
SOCKET: Final = "console.sock"  # in the authority's directory
# What the console has there. Who restores an authority makes a new TLS key for browsers.
DIRECTORY: Final = "console"
ADDRESS: Final = f"{DIRECTORY}/address"
LOCK: Final = f"{DIRECTORY}/lock"
TLS_KEY: Final = "tls.key"
TLS_CERTIFICATE: Final = "tls.pem"
OWNED: Final = (
    files.Owned(rf"{DIRECTORY}/(?:address|lock)", kept=False),
    files.Owned(rf"{DIRECTORY}/tls\.(?:key|key\.[0-9a-f]{{16}}|pem)", kept=False),
)
MAX_REQUEST: Final = 64 * 1024
MAX_ANSWER: Final = 4 * 1024 * 1024

# Kinds of `PREPARE`, with the types of their arguments; the numbers are those of the statements.
PREPARED: Final[Mapping[str, tuple[type, ...]]] = {
    "enroll": (bytes, str, bool, int, bool),  # csr, source, anonymous, lifetime, replaces the key
    "grant": (bytes, str, int),  # question, coarse filter ("" for none), seconds (0: as asked)
    "policy": (bytes,),  # digest of the file, as shown
    "delegate": (int, int),  # lifetime, longest time of a renewed grant
    "intermediate": (bytes, bool, int),  # csr, may enroll, lifetime
    "passkey": (bytes,),  # proposal
    "invitation": (str, int, int, bool),  # pattern, uses, seconds, anonymous
    "revoke-master": (str, str),  # reason, which master
}

_HINT: Final = "are the service and the console of one version of rossec?"

_PLAIN: Final = (int, str, bytes, bool)
_T = TypeVar("_T")


def to_value(item: object) -> Value:
    if isinstance(item, tuple):
        return [to_value(each) for each in item]
    if item is None or type(item) in _PLAIN:
        return item  # type: ignore[return-value]
    raise TypeError(f"{type(item).__name__} is not part of a record")


def from_value(kind: type[_T], value: Value) -> _T:
    found: _T = _read(kind, value)
    return found


def _read(kind: Any, value: Value) -> Any:
    if kind in _PLAIN or kind is NoneType:
        if type(value) is not kind:
            raise KeyMessageRefused(f"{type(value).__name__} where {kind.__name__} belongs", _HINT)
        return value
    if isinstance(kind, UnionType):
        possible = [each for each in get_args(kind) if each is not NoneType]
        return None if value is None else _read(possible[0], value)
    if not isinstance(value, list):
        raise KeyMessageRefused("a record that is no list", _HINT)
    if get_origin(kind) is tuple:
        first, last = get_args(kind)
        if last is not Ellipsis and len(value) != 2:
            raise KeyMessageRefused("a list has an epoch and a number", _HINT)
        return tuple(_read(first, each) for each in value)
    fields = get_type_hints(kind)
    if len(value) != len(fields):
        raise KeyMessageRefused(f"{kind.__name__} of {len(value)} fields", _HINT)
    return kind(*map(_read, fields.values(), value))


class Status(NamedTuple):
    """The service: `number` changes whenever anything that the console can show has changed."""

    domain: str
    fingerprint: str
    locked: bool
    remaining: int | None  # seconds; 0: until it is locked; None: it is locked
    number: int
    now: int
    phones: int  # passkeys that can approve
    has_master: bool  # whether the last call to the master succeeded


class NodeView(NamedTuple):
    """An identity: the newest of its name, or another key of it that is still valid."""

    name: str
    key: bytes
    not_before: int
    not_after: int
    anonymous: bool  # for anonymous nodes too
    revoked_at: int  # 0: it is not revoked
    reason: str


class GrantView(NamedTuple):
    """A signed grant; `data` is its COSE form (`grants.document.peek`)."""

    id: bytes
    node: str
    data: bytes
    at: int  # when it was signed
    expires: int
    cap: int  # until when the master renews it
    revoked_at: int  # 0: it is not revoked
    reason: str
    rules: str  # of the policy; empty: by hand
    delivery: str  # as `rossec grant list` shows it: held, fetched, waiting; empty: not known


class IdentityRequestView(NamedTuple):
    """A request for an identity that waits: for a person (`pending`), or the key (`approved`)."""

    id: bytes
    name: str
    key: bytes
    source: str
    arrived: int
    expires: int
    state: str
    anonymous: bool
    is_other_key: bool  # the name has, or had, another key
    csr: bytes  # DER, as `PREPARED` of "enroll" takes it


class AskedRight(NamedTuple):
    """One right that a node asks for, as the policy would grant it (see `grants.document`)."""

    right: int
    pattern: str
    type: str  # of the messages; empty: not known
    rules: str
    why: str  # the reason in the policy, not the node's
    permissions: bytes  # CBOR list of the AIF entries that would be granted


class GrantQuestion(NamedTuple):
    """A right that a node asks for, and that waits for a person.

    A request for several rights is as many questions, and `request` is the id that they share.
    """

    id: bytes
    node: str
    key: bytes
    why: str  # the node's own words
    at: int
    expires: int  # denied afterwards
    lifetime: int  # seconds that would be granted, renewals by the master included
    coarse: tuple[str, ...]  # names of filters that could be put on it
    rights: tuple[AskedRight, ...]
    request: bytes = b""


class QuestionAnswer(NamedTuple):
    """The answer to a question: `granted`, `denied`, or why nobody gave one."""

    node: str
    right: int
    pattern: str
    answer: str
    reason: str
    at: int


class InvitationView(NamedTuple):
    id: bytes
    pattern: str
    uses: int
    names: tuple[str, ...]  # that joined by it
    anonymous: bool
    expires: int
    at: int
    state: str


class PhoneView(NamedTuple):
    """A passkey."""

    id: bytes
    name: str
    at: int
    last_used: int  # 0: never
    added_by: str  # a phone's name; empty: the terminal
    ended: str  # why; empty: it can approve


class ApprovalView(NamedTuple):
    id: bytes
    kind: int
    sentence: str
    phone: str
    at: int
    state: str
    result: str


class EventView(NamedTuple):
    """An entry of the log of the record (`ca.store.values.LogEntry`)."""

    number: int
    at: int
    what: str
    subject: str
    detail: str


class DenialView(NamedTuple):
    """A right that a node lacked, as the master or another node refused it."""

    at: int
    node: str
    right: int
    name: str


class FactView(NamedTuple):
    """A fact of the graph, as `rossec.watchGraph` gives it; `kind`: publisher, type and so on."""

    kind: str
    name: str
    node: str


class PolicyRight(NamedTuple):
    """A right that a policy would give or take; `restriction` in words, `until` as its span."""

    node: str
    right: int
    pattern: str
    restriction: str
    until: str


class PolicyView(NamedTuple):
    path: str
    digest: bytes  # of the file; empty: there is none
    gives: tuple[PolicyRight, ...]
    takes: tuple[PolicyRight, ...]
    keeps: int
    mistakes: tuple[str, ...]
    refused: tuple[str, ...] = ()  # of single nodes: in no grant, though a rule allows it


class PolicyName(NamedTuple):
    """What the policy calls a node, a topic or a pattern; empty: it has no title, or no type."""

    name: str
    title: str
    type: str


class ListProgress(NamedTuple):
    """How far a revocation list has come."""

    epoch: int
    seq: int
    is_signed: bool
    is_at_master: bool
    nodes: int  # with a session at the master; 0: not known
    nodes_with_list: int


class Prepared(NamedTuple):
    id: bytes
    statement: bytes
    challenge: bytes
    until: int
    rp_id: str
    credentials: tuple[bytes, ...]
    payload: bytes


class ApprovalOutcome(NamedTuple):
    """What came of an approval: as in `ApprovalView`; `data` is what it made."""

    id: bytes
    state: str
    result: str
    data: bytes  # an identity bundle (PEM), or the text of a join code; empty otherwise


class LoginChallenge(NamedTuple):
    """A challenge for a login, or for a new passkey."""

    id: bytes
    challenge: bytes
    until: int
    rp_id: str
    credentials: tuple[bytes, ...]


class Proposal(NamedTuple):
    id: bytes
    name: str
    digits: str  # shown on both phones
    expires: int


class PasskeyAssertion(NamedTuple):
    """What a browser returns for a challenge: `navigator.credentials.get`."""

    credential: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes


class PasskeyRegistration(NamedTuple):
    """A new passkey with the code that allows it: `navigator.credentials.create`."""

    challenge_id: bytes
    code: str
    name: str
    client_data: bytes
    attestation_object: bytes


class Operation(NamedTuple):
    arguments: tuple[type, ...]  # as they are sent: a record stands for its fields
    answer: Any
    changes: bool  # audited, with who asked, before it is done
    of_strangers: bool  # anybody on the network may ask


OPERATIONS: Final[dict[str, Operation]] = {}
_C = TypeVar("_C")


def _operations(*, changes: bool = False, of_strangers: bool = False) -> Callable[[type[_C]], type[_C]]:
    # Enters the methods of a class into the table as their signatures say; each then asks for its operation.
    def enter(declared: type[_C]) -> type[_C]:
        for word, method in inspect.getmembers(declared, inspect.iscoroutinefunction):
            name, kinds = word.replace("_", "-"), get_type_hints(method)
            answer = kinds.pop("return")
            sent = (
                get_type_hints(each).values() if hasattr(each, "_fields") else [each]
                for each in kinds.values()
            )
            arguments = tuple(get_origin(kind) or kind for kind in chain(*sent))
            OPERATIONS[name] = Operation(arguments, answer, changes, of_strangers)
            setattr(declared, word, _asking(name, inspect.signature(method), answer))
        return declared

    return enter


def _asking(name: str, signature: inspect.Signature, answer: Any) -> Callable[..., Coroutine[Any, Any, Any]]:
    async def ask(client: Any, /, *given: Any, **named: Any) -> Any:
        bound = signature.bind(client, *given, **named)
        bound.apply_defaults()
        _, *values = bound.arguments.values()
        flat = chain(*(value if isinstance(value, tuple) else [value] for value in values))
        found = await client.ask(name, *flat)
        return None if answer is NoneType else from_value(answer, found)

    return ask


@_operations()
class _Looking:
    async def status(self) -> Status: ...
    async def nodes(self) -> tuple[NodeView, ...]: ...
    async def grants(self) -> tuple[GrantView, ...]: ...  # in force, and those that ended within 30 days
    async def identity_requests(self) -> tuple[IdentityRequestView, ...]: ...
    async def questions(self) -> tuple[GrantQuestion, ...]: ...

    async def consider(self, question: bytes, coarse: str, seconds: int) -> tuple[AskedRight, ...]:
        """What would be granted, through the filter `coarse`, for `seconds` (0: as asked)."""

    async def question_answers(self, question: bytes) -> tuple[QuestionAnswer, ...]: ...  # none: it waits
    async def invitations(self) -> tuple[InvitationView, ...]: ...
    async def phones(self) -> tuple[PhoneView, ...]: ...
    async def proposals(self) -> tuple[Proposal, ...]: ...
    async def approvals(self, count: int) -> tuple[ApprovalView, ...]: ...  # newest first, at most so many
    async def events(self, before: int, count: int) -> tuple[EventView, ...]: ...  # `before` 0: the newest
    async def denials(self) -> tuple[DenialView, ...]: ...  # of the last day; raises if there is no master
    async def graph(self) -> tuple[FactView, ...]: ...  # raises if there is no master
    async def policy(self) -> PolicyView: ...
    async def policy_names(self) -> tuple[PolicyName, ...]: ...  # titles and types
    async def trust_status(self, epoch: int, seq: int) -> ListProgress: ...

    async def prepare(self, kind: str, arguments: list[Value], owner: str = "") -> Prepared:
        """Make a statement: arguments as in `PREPARED`, `owner` as `of_phone` and `of_looker` say."""

    async def outcome(self, approval: bytes) -> ApprovalOutcome: ...
    async def phone_link(self, owner: str = "") -> str: ...  # a one-time code


@_operations(changes=True)
class _Changing:
    # What takes away returns nothing, or the number of the list: (0, 0) while the key is locked.
    async def deny_request(self, request: bytes, reason: str) -> None: ...
    async def deny_question(self, question: bytes, reason: str) -> None: ...
    async def revoke_grant(self, grant: bytes, reason: str) -> tuple[int, int]: ...
    async def revoke_node(self, name: str, reason: str) -> tuple[int, int]: ...  # not of a master
    async def end_invitation(self, invitation: bytes, reason: str) -> None: ...
    async def remove_phone(self, phone: bytes, reason: str) -> None: ...
    async def end_proposal(self, proposal: bytes) -> None: ...
    async def approve(self, statement: bytes, assertion: PasskeyAssertion) -> ApprovalOutcome: ...


@_operations(of_strangers=True)
class _Entering:
    # The console's own sessions follow from these. A code is used up by the operation that takes it.
    async def login_challenge(self, origin: str) -> LoginChallenge: ...
    async def login(self, challenge: bytes, assertion: PasskeyAssertion) -> str: ...  # the phone's name
    async def redeem(self, code: str) -> None: ...  # a code from the terminal: to look
    async def new_passkey(self, origin: str, rp_id: str) -> LoginChallenge: ...
    async def add_passkey(self, registration: PasskeyRegistration) -> PhoneView: ...  # as `redeem`
    async def propose_passkey(self, registration: PasskeyRegistration) -> Proposal: ...  # one of `phone_link`


class Operations(_Looking, _Changing, _Entering):
    """The table of all that the console can ask, with the answers; the console's client says how to `ask`.

    The service's handler of an operation is the method of that name, of one of its parts.
    """


_ARGUMENTS: Final = {name: operation.arguments for name, operation in OPERATIONS.items()}


def read_request(body: bytes) -> messages.ServiceRequest:
    request = messages.read_request(body, _ARGUMENTS, MAX_REQUEST)
    match request:
        case messages.ServiceRequest("prepare", (str() as kind, list() as arguments, str())) if tuple(
            map(type, arguments)
        ) != PREPARED.get(kind):
            raise KeyMessageRefused(f"{kind[:40]!a} is not prepared with such arguments", _HINT)
    return request


def checked(answer: Value) -> Value:
    if len(messages.write_answer(answer)) > MAX_ANSWER:
        raise KeyServiceRefused(
            f"the answer has more than {MAX_ANSWER} bytes", "use the commands of the authority"
        )
    return answer


_MOST: Final = 4  # rights that are listed


def sentence(statement: Statement, payload: bytes) -> str:
    match statement.what:
        case kinds.Enroll(name=name, replaces=replaces):
            text = f"identity of {name}" + ", with another key than before" * replaces
        case kinds.GrantStatement():
            text = given(bodies_of(payload))
        case kinds.PolicyChange():
            text = "the changed policy is in force"
        case kinds.DelegateStatement(lifetime=lifetime):
            text = f"the master may renew grants for {clock.format_duration(lifetime)}"
        case kinds.IntermediateStatement(enrolls=enrolls):
            new = "and enroll nodes" if enrolls else "for nodes known here"
            text = f"an intermediate authority may renew identities {new}"
        case kinds.NewPasskey(name=name):
            text = f"phone {name}"
        case kinds.Invitation(pattern=pattern, uses=uses):
            text = f"join code for {uses} of {pattern}"
        case kinds.RevokeMaster(reason=reason, master=master):
            which = "the master" if master == MASTER else f"the master {master}"
            text = f"revocation of {which}" + f": {reason}" * bool(reason)
        case kinds.ForeignDomainStatement():
            text = "another domain"
        case unknown:  # a new kind must say itself what it is: nobody approves one under another's name
            assert_never(unknown)
    return peer_limits.printable(text)


def given(bodies: Iterable[bytes]) -> str:
    """What grants with these claims give, and until when: what was approved, not what was asked."""
    try:
        found = [document.read_claims(body, bytes(model.ID_SIZE)) for body in bodies]
    except (EncodingError, GrantError):
        found = []
    if not found:
        return "a right of a node"
    every = (each for grant in found for each in grant.permissions)
    rights = dict.fromkeys(f"{each}{' (not all of it)' * each.is_narrowed}" for each in every)
    more = f" and {len(rights) - _MOST} more" if len(rights) > _MOST else ""
    until = clock.format_time(min(max(each.expires, each.cap) for each in found))
    return f"{found[0].subject} may {', '.join([*rights][:_MOST])}{more}, until {until}"


def bodies_of(payload: bytes) -> list[bytes]:
    """The claims of the grants in the payload of an approval; none where it is malformed."""
    with suppress(EncodingError):
        match decode(payload, limit=kinds.MAX_PAYLOAD):
            case [_, _, [*grants]]:
                pairs = (grant for grant in grants if isinstance(grant, list) and len(grant) == 2)
                return [body for body, _ in pairs if isinstance(body, bytes)]
            case _:
                pass
    return []
