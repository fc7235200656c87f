"""The TCPROS handshakes of topics and services inside the channel, both sides, as functions on header fields.
Pure.

Fields are strictly read, never trusted: the caller's name comes from its certificate, never from `callerid`
alone, its rights from the grants it presents. The peer is authorized before this node looks up the topic or
service, so that without a grant it cannot tell one that exists from one that does not; probes need the right
as well (attack N6). Inside, towards programs and the master, a name of another origin is an alias below
`/remote`; on every wire to a peer stands the origin's name, and an alias that arrives from one is refused.
Access gets the local name, the header the origin's.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from ca.certificates import Identity
from ca.errors import NameRefused
from ca.names import REMOTE, alias_of, check_name, is_alias, origin_of, refuse_alias, shown, split_alias
from grants.decision import Decision
from grants.model import Right
from rossec.errors import ConfigurationError, ConnectionHeaderRefused
from rossec.participant.access import FIELD, HandshakeAccess
from rossec.ros.names import ANY_TYPE

if TYPE_CHECKING:
    from rossec.participant.definitions import Definition
    from rossec.participant.message_types import MessageType

OFFERS: Final[Mapping[str, str]] = {
    "registerPublisher": "published",
    "registerService": "provided",
    "setParam": "set",
    "deleteParam": "deleted",
}
"""Calls to the master that concern what is here, with what is done to the name."""
NOT_OFFERED: Final = f"names below {REMOTE} are those of other masters"
_NAMES: Final = ("topic", "service")

Fields = dict[str, bytes]
Rename = Callable[[str], str]


def check_caller(fields: Mapping[str, bytes], peer: Identity) -> None:
    caller = text(fields, "callerid")
    # Programs and logs would believe the name that it gives itself (attack `another-name`).
    if not peer.covers(caller):
        raise ConnectionHeaderRefused(
            f"a node certified as {shown(peer.name)} calls itself {caller}",
            "start it under the name it was enrolled with",
        )


def refuse_on_wire(name: str) -> str:
    """Return `name`, which a peer sent, unless it is below `/remote`."""
    if is_alias(name):
        raise ConnectionHeaderRefused(
            f"{name} is an alias where it was written, and no name on the wire",
            "a peer is asked by the origin's name: does the caller run an older rossec?",
        )
    return name


def text(fields: Mapping[str, bytes], key: str) -> str:
    """Field `key` as printable text of at most 4096 characters."""
    value = fields.get(key)
    if value is None:
        raise ConnectionHeaderRefused(f"the connection header has no {key!r}")
    try:
        decoded = value.decode()
    except UnicodeDecodeError:
        raise ConnectionHeaderRefused(f"the connection header's {key!r} is not text") from None
    if not decoded.isprintable() and key != "error":
        raise ConnectionHeaderRefused(f"the connection header's {key!r} holds control characters")
    # It goes into logs and errors: one line, bounded (attack `control-characters`).
    return "".join(char if char.isprintable() else " " for char in decoded)[:4096]


def refuse_offer(name: str, done: str) -> str:
    """Return `name`, which is to be published, provided or set, unless it is below `/remote`."""
    if is_alias(name):
        raise ConfigurationError(
            f"{name} cannot be {done} here: {NOT_OFFERED}",
            "take a name outside /remote; the others see it below /remote/LABEL",
        )
    return name


def offer_refusal(method: str, params: Sequence[object]) -> list[object] | None:
    """The answer to a program's call that offers a (resolved) name below `/remote`; None: it does not."""
    name = params[1] if method in OFFERS and len(params) > 1 else None
    if not isinstance(name, str):
        return None
    try:
        refuse_offer(name, OFFERS[method])
    except ConfigurationError as error:
        return [-1, f"rossec: {error} ({error.hint})", 0]
    return None


def fields_on_wire(fields: Mapping[str, bytes]) -> Fields:
    """A connection header for a peer: with the origin's name of the topic or service."""
    named = {key: origin_of(text(fields, key)).encode() for key in _NAMES if key in fields}
    return {**fields, **named}


def fields_here(fields: Mapping[str, bytes], peer: Identity, name: str | None = None) -> Fields:
    """A peer's header for a program: the peer by its alias, a topic by its local `name`."""
    renamed: Fields = {}
    if peer.is_foreign and "callerid" in fields:
        renamed["callerid"] = peer.name.encode()
    if name is not None and "topic" in fields:
        renamed["topic"] = name.encode()
    return {**fields, **renamed}


def caller_for(peer: Identity, name: str, certified: str) -> str:
    """By which name a node calls itself to `peer`: a foreigner honours no certified tails."""
    return certified if peer.is_foreign else name


def caller_here(peer: Identity, caller: str) -> str:
    """The caller_id of a peer for a program: a foreign one's alias, or it would look like a node here."""
    return peer.name if peer.is_foreign else caller


def answer_here(peer: Identity, domain: str, method: str, value: object) -> object:
    """The answer of `peer` about itself in local names; `domain` is this node's."""
    label = _label(peer)
    if label is None:
        return value

    def local(name: str) -> str:
        own = name.removeprefix(f"{domain}:")
        return alias_of(label, name) if own == name else refuse_alias(check_name(own))

    return _renamed(method, value, local)


def answer_for(peer: Identity, method: str, value: object) -> object:
    """This node's answer about itself for `peer`: to a foreigner its own names, and `DOMAIN:/name` for the
    peer's.

    Those of a third domain are left out. Nobody gets statistics: they count what a grant withholds, and when
    it came.
    """
    if method == "getBusStats":
        return [[], [], []]
    label = _label(peer)
    if label is None:
        return value

    def written(name: str) -> str:
        found = split_alias(name)
        if found is None:
            return name
        if found[0] != label:
            raise NameRefused(f"{shown(name)} is not of the caller's domain")
        return f"{peer.domain}:{found[1]}"

    return _renamed(method, value, written)


def _label(peer: Identity) -> str | None:
    found = split_alias(peer.name) if peer.is_foreign else None
    return None if found is None else found[0]


def _renamed(method: str, value: object, rename: Rename) -> object:
    match method, value:
        case "getName", str() as name:
            return (_rename_all(rename, name) or ("",))[0]
        case (("getPublications" | "getSubscriptions" | "getBusInfo"), list() as rows):
            found = list[object]()
            for row in rows:
                match row:
                    case [str() as topic, str() as kind] if (names := _rename_all(rename, topic)) is not None:
                        found.append([*names, kind])
                    case [number, str() as end, direction, transport, str() as topic, *rest]:
                        names = _rename_all(rename, *([] if "://" in end else [end]), topic)
                        if names is not None:
                            end = names[0] if len(names) > 1 else end
                            found.append([number, end, direction, transport, names[-1], *rest])
                    case _:  # of a third domain, or no row
                        pass
            return found
        case (("getName" | "getPublications" | "getSubscriptions" | "getBusInfo"), _):
            return "" if method == "getName" else []
        case _:
            return value


def _rename_all(rename: Rename, *names: str) -> tuple[str, ...] | None:
    try:
        return tuple(rename(name) for name in names)
    except NameRefused:
        return None


@dataclass(frozen=True)
class TopicEndpoint:
    """A topic as this node has it: its resolved name and its type."""

    topic: str
    type: "MessageType"


def _common(caller: str, key: str, name: str, type_name: str, md5sum: str) -> Fields:
    named = {"callerid": caller, key: name, "type": type_name, "md5sum": md5sum}
    return {each: value.encode() for each, value in named.items()}


def subscriber_header(caller: str, endpoint: TopicEndpoint, access: HandshakeAccess, now: int) -> Fields:
    return {
        **_common(caller, "topic", origin_of(endpoint.topic), endpoint.type.name, endpoint.type.md5sum),
        "message_definition": endpoint.type.octets,
        "tcp_nodelay": b"1",
        FIELD: access.present(Right.SUBSCRIBE, endpoint.topic, now),
    }


def publisher_header(
    caller: str, endpoint: TopicEndpoint, access: HandshakeAccess, now: int, *, latching: bool
) -> Fields:
    return {
        **_common(caller, "topic", endpoint.topic, endpoint.type.name, endpoint.type.md5sum),
        "message_definition": endpoint.type.octets,
        "latching": b"1" if latching else b"0",
        FIELD: access.present(Right.PUBLISH, endpoint.topic, now),
    }


def requested_topic(fields: Mapping[str, bytes]) -> str:
    return refuse_on_wire(text(fields, "topic"))


def admit_subscriber(
    fields: Mapping[str, bytes], peer: Identity, access: HandshakeAccess, now: int
) -> Decision:
    """Decide on a subscriber from its header, before anything about the topic is looked up."""
    check_caller(fields, peer)
    topic = requested_topic(fields)
    return access.authorize(peer, fields.get(FIELD), Right.SUBSCRIBE, topic, now)


def admit_publisher(
    fields: Mapping[str, bytes],
    peer: Identity,
    topic: str,
    kind: "Definition",
    access: HandshakeAccess,
    now: int,
) -> Decision:
    """Decide on a publisher of `topic` from the header it answered with.

    The caller applies the decision's restrictions to each message (`topic_guard.guard_for`), by the
    receiver's definition: the publisher's may differ under the same md5sum.
    """
    # 1. A refusal has no other fields.
    if "error" in fields:
        raise ConnectionHeaderRefused(f"{shown(peer.name)} refuses: {text(fields, 'error')}")
    # 2. Who it says it is, by its certificate.
    check_caller(fields, peer)
    # 3. What was asked for, and no other topic for which it has a grant.
    if text(fields, "topic") != origin_of(topic):
        raise ConnectionHeaderRefused(f"{shown(peer.name)} answers with another topic than {shown(topic)}")
    check_type(fields, topic, kind)
    # 4. Its right, by the name that the topic has here.
    return access.authorize(peer, fields.get(FIELD), Right.PUBLISH, topic, now)


def check_type(fields: Mapping[str, bytes], topic: str, kind: "Definition") -> None:
    """Compare type and md5sum as TCPROS does; `*` matches any, on either side."""
    name, md5sum = text(fields, "type"), text(fields, "md5sum")
    if not _matches(name, kind.name) or not _matches(md5sum, kind.md5sum):
        raise ConnectionHeaderRefused(
            f"{shown(topic)} carries {kind.name} ({kind.md5sum}), the peer expects {name} ({md5sum})",
            "both sides need the same version of the message package"
            if _matches(name, kind.name)
            else "name the type that the topic carries, or another topic",
        )


def _matches(one: str, other: str) -> bool:
    return ANY_TYPE in {one, other} or one == other


@dataclass(frozen=True)
class ExpectedService:
    """Name and md5sum of a service type; `*` matches any."""

    type_name: str
    md5sum: str


ANY: ExpectedService = ExpectedService(ANY_TYPE, ANY_TYPE)


def client_header(
    caller: str,
    service: str,
    kind: ExpectedService,
    access: HandshakeAccess,
    now: int,
    *,
    persistent: bool = False,
    probe: bool = False,
) -> Fields:
    flags = {"persistent": persistent, "probe": probe}
    return {
        **_common(caller, "service", origin_of(service), kind.type_name, kind.md5sum),
        **{key: b"1" for key, wanted in flags.items() if wanted},
        **caller_proof(service, access, now),
    }


def server_header(
    caller: str, service: str, kind: ExpectedService, access: HandshakeAccess, now: int
) -> Fields:
    return {
        **_common(caller, "service", service, kind.type_name, kind.md5sum),
        "request_type": f"{kind.type_name}Request".encode(),
        "response_type": f"{kind.type_name}Response".encode(),
        **provider_proof(service, access, now),
    }


def caller_proof(service: str, access: HandshakeAccess, now: int) -> Fields:
    return {FIELD: access.present(Right.CALL, service, now)}


def provider_proof(service: str, access: HandshakeAccess, now: int) -> Fields:
    return {FIELD: access.present(Right.PROVIDE, service, now)}


def requested_service(fields: Mapping[str, bytes]) -> str:
    return refuse_on_wire(text(fields, "service"))


def admit_caller(fields: Mapping[str, bytes], peer: Identity, access: HandshakeAccess, now: int) -> Decision:
    """Decide on a client from its header, before anything about the service is looked up.

    A decision with restrictions must be applied to each request, or refused with
    `Decision.require_unrestricted`: the header of a service carries no definition to apply them by.
    """
    check_caller(fields, peer)
    return access.authorize(peer, fields.get(FIELD), Right.CALL, requested_service(fields), now)


def admit_provider(
    fields: Mapping[str, bytes], peer: Identity, service: str, access: HandshakeAccess, now: int
) -> Decision:
    if "error" in fields:
        raise ConnectionHeaderRefused(f"{shown(peer.name)} refuses: {text(fields, 'error')}")
    check_caller(fields, peer)
    return access.authorize(peer, fields.get(FIELD), Right.PROVIDE, service, now)


def check_md5(fields: Mapping[str, bytes], service: str, md5sum: str) -> None:
    """Compare the md5sums as ROS does, which ignores the type's name; `*` matches any."""
    peer_md5sum = text(fields, "md5sum")
    if peer_md5sum != md5sum and ANY_TYPE not in {peer_md5sum, md5sum}:
        raise ConnectionHeaderRefused(
            f"{shown(service)} has the md5sum {md5sum} here, {peer_md5sum} at the peer",
            "both sides need the same version of the service's package",
        )


def is_set(fields: Mapping[str, bytes], flag: str) -> bool:
    """Whether the header sets `persistent` or `probe`; stock clients write 1 or true."""
    return fields.get(flag, b"").lower() in {b"1", b"true"}
