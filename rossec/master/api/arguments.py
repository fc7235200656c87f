"""Checks of the arguments of master calls; the texts are stock rosmaster's (validators.py). Pure.

Stricter than stock, because rights are matched on names: a topic, service or parameter must have a
well-formed ROS name after it is resolved, and a URI must have a host and a port to connect to. What
a relay of the own domain says is shown to people and given to nodes: its doors are well-formed
addresses, and everything has a limit.
"""

from collections.abc import Callable
from typing import Final, TypeVar

from ca.errors import NameRefused
from ca.names import check_label, check_name, check_pattern
from rossec.master.rights.renewals import OFFER_LIMIT, Settlement
from rossec.master.state.forwarded_ports import AT_ONCE, KINDS, MAX_PEERS, Door, PeerWay, Target
from rossec.master.state.registry import is_connectable, is_type_name
from rossec.ros import names
from rossec.ros.names import build_door

KEY_LIMIT: Final = 255
_TEXT_LIMIT: Final = 255
_DIGEST: Final = 32  # bytes of a SHA-256
_MAX_COUNT: Final = 1 << 53

T = TypeVar("T")

Check = Callable[[object, str], object]
"""Takes the argument and the caller's name; returns the canonical argument or raises."""


class ArgumentRefused(Exception):
    """An argument is invalid; the text is the status to answer with."""


def anything(value: object, caller: str) -> object:  # noqa: ARG001 - the signature of a Check
    return value


def not_none(label: str) -> Check:
    # XML-RPC's nil stock clients cannot send either.
    return _checked(label, "specified", lambda value: value is not None)


def key(label: str) -> Check:
    def check(value: object, caller: str) -> str:
        resolved = names.resolve(_text(value, label), caller)
        if len(resolved) > KEY_LIMIT:
            raise ArgumentRefused(f"ERROR: parameter [{label}] is too long")
        return resolved if resolved == names.SEPARATOR else _well_formed(resolved, label)

    return check


def search_key(label: str) -> Check:
    # Not resolved: the search does that.
    return lambda value, _caller: _text(value, label)[:KEY_LIMIT]


def node(label: str) -> Check:
    return lambda value, caller: names.resolve(_plain_name(value, label), caller)


def topic(label: str) -> Check:
    def check(value: object, caller: str) -> str:
        plain = _plain_name(value, label)
        if plain == names.SEPARATOR:
            raise ArgumentRefused(f"ERROR: parameter [{label}] cannot be the global namespace")
        return _well_formed(names.resolve(plain, caller), label)

    return check


def subgraph(label: str) -> Check:
    def check(value: object, caller: str) -> str:
        if not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a string")
        return names.resolve(value, caller) if value else ""

    return check


def type_name(label: str) -> Check:
    def check(value: object, _caller: str) -> str:
        if not value or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a non-empty string")
        if value != names.ANY_TYPE and not is_type_name(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not a valid package resource name")
        return value

    return check


def uri(label: str, scheme: str) -> Check:
    def check(value: object, _caller: str) -> str:
        if not value or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not an XMLRPC URI")
        if not is_connectable(value, scheme):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not an RPC URI")
        return value

    return check


def text(label: str) -> Check:
    return _checked(label, "a string", lambda value: isinstance(value, str))


def number(label: str) -> Check:
    return _checked(label, "a number", lambda value: type(value) is int and value >= 0)


def binary(label: str) -> Check:
    return _checked(label, "base64", lambda value: isinstance(value, bytes))


def kind(label: str) -> Check:
    return _checked(label, f"one of {', '.join(KINDS)}", lambda value: value in KINDS)


def _checked(label: str, kind: str, is_valid: Callable[[object], bool]) -> Check:
    def check(value: object, _caller: str) -> object:
        if not is_valid(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be {kind}")
        return value

    return check


def binaries(label: str, most: int) -> Check:
    return lambda value, _caller: _items(value, label, most, bytes, "base64")


def patterns(label: str, most: int) -> Check:
    def check(value: object, _caller: str) -> list[str]:
        items = _items(value, label, most, str, "text")
        try:
            return [check_pattern(item) if item else item for item in items]
        except NameRefused as error:
            raise ArgumentRefused(f"ERROR: parameter [{label}]: {error}") from error

    return check


def name(label: str) -> Check:
    def check(value: object, _caller: str) -> str:
        try:
            return check_name(value if isinstance(value, str) else "")
        except NameRefused as error:
            raise ArgumentRefused(f"ERROR: parameter [{label}]: {error}") from error

    return check


def doors(label: str) -> Check:
    def check(value: object, _caller: str) -> dict[Target, Door]:
        if not isinstance(value, list) or len(value) > AT_ONCE:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {AT_ONCE}")
        found = [_door(each) for each in value]
        if None in found:
            raise ArgumentRefused(f"ERROR: parameter [{label}] has a door that is not one")
        return dict(each for each in found if each is not None)

    return check


def ways(label: str) -> Check:
    def check(value: object, _caller: str) -> dict[str, PeerWay]:
        if not isinstance(value, dict) or len(value) > MAX_PEERS:
            raise ArgumentRefused(f"ERROR: parameter [{label}] has at most {MAX_PEERS} peers")
        found = {peer: _way(peer, way) for peer, way in value.items()}
        if None in found.values():
            raise ArgumentRefused(f"ERROR: parameter [{label}] has a way that is not one")
        return {peer: way for peer, way in found.items() if way is not None}

    return check


def settlements(value: object, _caller: str) -> list[Settlement]:
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


def _items(value: object, label: str, most: int, kind: type[T], content: str) -> list[T]:
    if not isinstance(value, list) or len(value) > most:
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {most}")
    items = [item for item in value if isinstance(item, kind)]
    if len(items) != len(value):
        raise ArgumentRefused(f"ERROR: parameter [{label}] must hold {content} only")
    return items


def _well_formed(resolved: str, label: str) -> str:
    try:
        return check_name(resolved)
    except NameRefused as error:
        raise ArgumentRefused(f"ERROR: parameter [{label}] contains illegal chars") from error


def _text(value: object, label: str) -> str:
    if not value:
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be specified and non-empty")
    if not isinstance(value, str):
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be a string")
    return value


def _plain_name(value: object, label: str) -> str:
    if not value or not isinstance(value, str):
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be a non-empty string")
    if ":" in value or " " in value:  # stock's check for the usual mistake, a URI for a name
        raise ArgumentRefused(f"ERROR: parameter [{label}] contains illegal chars")
    return value


def _door(value: object) -> tuple[Target, Door] | None:
    match value:
        case [str() as peer, str() as what, str() as target, str() as host, int() as port]:
            pass
        case _:
            return None
    try:
        check_label(peer)
        check_name(target)
        is_open = is_connectable(build_door(host, port), "http")
    except (NameRefused, ValueError):
        return None
    return (Target(peer, what, target), Door(host, port)) if is_open and what in KINDS else None


def _way(peer: object, value: object) -> PeerWay | None:
    try:
        check_label(peer if isinstance(peer, str) else "")
    except NameRefused:
        return None
    if not isinstance(value, dict) or value.keys() != frozenset(PeerWay._fields):
        return None
    state, router = value["state"], value["router"]
    if not all(isinstance(each, str) and len(each) <= _TEXT_LIMIT for each in (state, router)):
        return None
    counts = [value[each] for each in ("rtt_ms", "retransmissions", "streams")]
    # Infinity, which has no integer, is above the limit; of NaN nothing is true.
    if not all(type(each) in (int, float) and 0 <= each <= _MAX_COUNT for each in counts):
        return None
    rtt_ms, retransmissions, streams = counts
    return PeerWay(state, float(rtt_ms), int(retransmissions), router, int(streams))
