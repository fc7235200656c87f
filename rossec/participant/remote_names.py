"""Names of other masters and domains at the edge of a node. Pure.

Inside, towards programs and towards the master, a name of another origin is an alias below
`/remote`; on every wire to a peer stands the origin's name, and an alias that arrives from one is
refused. A foreign node calls itself by its certified name, which programs get as its alias: they
have no other way to tell it from a node of the same name here. In answers about itself a node tells
a foreign caller its own names, and those of the caller's domain as `DOMAIN:/name`; those of a third
domain it leaves out.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import (
    REMOTE,
    alias_of,
    is_alias,
    origin_of,
    refuse_alias,
    shown,
    split_alias,
)
from ca.errors import NameRefused
from ca.names import check_name
from rossec.errors import ConfigurationError
from rossec.participant.header_fields import Fields, text

OFFERS: Final[Mapping[str, str]] = {
    "registerPublisher": "published",
    "registerService": "provided",
    "setParam": "set",
    "deleteParam": "deleted",
}
"""Calls to the master that concern what is here, with what is done to the name."""
NOT_OFFERED: Final = f"names below {REMOTE} are those of other masters"
_NAMES: Final = ("topic", "service")

Rename = Callable[[str], str]


def refuse_offer(name: str, done: str) -> str:
    """Return `name`, which is to be published, provided or set, unless it is below `/remote`.

    Raises:
        ConfigurationError: it is.
    """
    if is_alias(name):
        raise ConfigurationError(
            f"{name} cannot be {done} here: {NOT_OFFERED}",
            "take a name outside /remote; the others see it below /remote/LABEL",
        )
    return name


def offer_refusal(method: str, params: Sequence[object]) -> list[object] | None:
    """The answer to a program's call to the master that offers a name below `/remote`; None: none.

    `params`: with the name resolved.
    """
    name = params[1] if method in OFFERS and len(params) > 1 else None
    if not isinstance(name, str):
        return None
    try:
        refuse_offer(name, OFFERS[method])
    except ConfigurationError as error:
        return [-1, f"rossec: {error} ({error.hint})", 0]
    return None


def fields_on_wire(fields: Mapping[str, bytes]) -> Fields:
    """A connection header for a peer: with the origin's name of the topic or service.

    Raises:
        NameRefused: below `/remote`, but no alias.
        ConnectionHeaderRefused: the name is not text.
    """
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
    """The caller_id of a peer for a program: that of a foreign one is its alias."""
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
    """This node's answer about itself for `peer`.

    Nobody gets statistics: they count what a grant withholds, and when it came.
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
    """What the domain of a foreign peer is called here; None: it is of the own one."""
    found = split_alias(peer.name) if peer.is_foreign else None
    return None if found is None else found[0]


def _renamed(method: str, value: object, rename: Rename) -> object:
    match method, value:
        case "getName", str() as name:
            return (_rename_all(rename, name) or ("",))[0]
        case (("getPublications" | "getSubscriptions"), list() as rows):
            return [row for each in rows if (row := _topic_row(each, rename)) is not None]
        case "getBusInfo", list() as rows:
            return [row for each in rows if (row := _bus_entry(each, rename)) is not None]
        case (("getName" | "getPublications" | "getSubscriptions" | "getBusInfo"), _):
            return "" if method == "getName" else []
        case _:
            return value


def _topic_row(row: object, rename: Rename) -> list[object] | None:
    match row:
        case [str() as topic, str() as kind]:
            names = _rename_all(rename, topic)
            return None if names is None else [*names, kind]
        case _:
            return None


def _bus_entry(entry: object, rename: Rename) -> list[object] | None:
    """One connection; the other end is a node's name, or a publisher's URI."""
    match entry:
        case [number, str() as end, direction, transport, str() as topic, *rest]:
            names = _rename_all(rename, *([] if "://" in end else [end]), topic)
            if names is None:
                return None
            return [
                number,
                names[0] if len(names) > 1 else end,
                direction,
                transport,
                names[-1],
                *rest,
            ]
        case _:
            return None


def _rename_all(rename: Rename, *names: str) -> tuple[str, ...] | None:
    try:
        return tuple(rename(name) for name in names)
    except NameRefused:
        return None
