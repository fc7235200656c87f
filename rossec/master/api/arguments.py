"""Validation of the arguments of master calls; the texts are stock rosmaster's (validators.py).

Stricter than stock, because rights are matched on names: a topic, service or parameter must have a
well-formed ROS name after it is resolved, and a URI must have a host and a port to connect to.

Validation of the arguments of a relay's calls. Pure.

A relay is a member of the own domain, and what it says is shown to people and given to nodes: doors
are well-formed addresses, and everything has a limit.
"""

from collections.abc import Callable
from typing import Final

from ca.errors import NameRefused
from ca.names import check_label, check_name, check_pattern
from rossec.master.state.forwarded_ports import AT_ONCE, KINDS, MAX_PEERS, Door, Target, Way
from rossec.master.state.registry import is_connectable
from rossec.ros import names
from rossec.ros.names import build_door

KEY_LIMIT: Final = 255

Check = Callable[[object, str], object]
"""Takes the argument and the caller's name; returns the canonical argument or raises."""


class ArgumentRefused(Exception):
    """An argument is invalid; the text is the status to answer with."""


def anything(value: object, caller: str) -> object:  # noqa: ARG001 - the signature of a Check
    return value


def not_none(label: str) -> Check:
    """Any value but XML-RPC's nil, which stock clients cannot send either."""

    def check(value: object, _caller: str) -> object:
        if value is None:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be specified")
        return value

    return check


def key(label: str) -> Check:
    def check(value: object, caller: str) -> str:
        resolved = names.resolve(_text(value, label), caller)
        if len(resolved) > KEY_LIMIT:
            raise ArgumentRefused(f"ERROR: parameter [{label}] is too long")
        return resolved if resolved == names.SEPARATOR else _well_formed(resolved, label)

    return check


def search_key(label: str) -> Check:
    """A parameter name, not resolved: the search resolves it."""

    def check(value: object, _caller: str) -> str:
        return _text(value, label)[:KEY_LIMIT]

    return check


def node(label: str) -> Check:
    def check(value: object, caller: str) -> str:
        return names.resolve(_plain_name(value, label), caller)

    return check


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
        if value != names.ANY_TYPE and not _is_resource_name(value):
            text = f"ERROR: parameter [{label}] is not a valid package resource name"
            raise ArgumentRefused(text)
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


def _checked(label: str, kind: str, is_valid: Callable[[object], bool]) -> Check:
    def check(value: object, _caller: str) -> object:
        if not is_valid(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be {kind}")
        return value

    return check


def binaries(label: str, most: int) -> Check:
    def check(value: object, _caller: str) -> list[bytes]:
        if not isinstance(value, list) or len(value) > most:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {most}")
        items = [item for item in value if isinstance(item, bytes)]
        if len(items) != len(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must hold base64 only")
        return items

    return check


def patterns(label: str, most: int) -> Check:
    def check(value: object, _caller: str) -> list[str]:
        if not isinstance(value, list) or len(value) > most:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {most}")
        items = [item for item in value if isinstance(item, str)]
        if len(items) != len(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must hold text only")
        try:
            return [check_pattern(item) if item else item for item in items]
        except NameRefused as error:
            raise ArgumentRefused(f"ERROR: parameter [{label}]: {error}") from error

    return check


def _is_resource_name(value: str) -> bool:
    return value.count("/") == 1 and len(value) <= KEY_LIMIT and value.isprintable()


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


_TEXT_LIMIT: Final = 255
_MAX_COUNT: Final = 1 << 53
_WAY: Final = frozenset(Way._fields)


def kind(label: str) -> Check:
    def check(value: object, _caller: str) -> str:
        if value not in KINDS or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be one of {', '.join(KINDS)}")
        return value

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
    def check(value: object, _caller: str) -> dict[str, Way]:
        if not isinstance(value, dict) or len(value) > MAX_PEERS:
            raise ArgumentRefused(f"ERROR: parameter [{label}] has at most {MAX_PEERS} peers")
        found = {peer: _way(way) for peer, way in value.items() if _is_label(peer)}
        if len(found) != len(value) or None in found.values():
            raise ArgumentRefused(f"ERROR: parameter [{label}] has a way that is not one")
        return {peer: way for peer, way in found.items() if way is not None}

    return check


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


def _way(value: object) -> Way | None:
    if not isinstance(value, dict) or value.keys() != _WAY:
        return None
    texts, numbers = (value["state"], value["router"]), ("rtt_ms", "retransmissions", "streams")
    if not all(isinstance(each, str) and len(each) <= _TEXT_LIMIT for each in texts):
        return None
    if not all(_is_count(value[each]) for each in numbers):
        return None
    return Way(
        str(value["state"]),
        float(value["rtt_ms"]),
        int(value["retransmissions"]),
        str(value["router"]),
        int(value["streams"]),
    )


def _is_count(value: object) -> bool:
    # Whether it is a number that is not negative; neither is infinity, which has no integer.
    return type(value) in (int, float) and 0 <= value <= _MAX_COUNT  # type: ignore[operator]


def _is_label(value: object) -> bool:
    try:
        check_label(value if isinstance(value, str) else "")
    except NameRefused:
        return False
    return True
