"""Validation of the arguments of a relay's calls. Pure.

A relay is a member of the own domain, and what it says is shown to people and given to nodes: doors
are well-formed addresses, and everything has a limit.
"""

from typing import Final

from ca.domains.aliases import check_label
from ca.errors import NameRefused
from ca.names import check_name
from rossec.master.api.arguments import ArgumentRefused, Check
from rossec.master.state.addresses import is_connectable
from rossec.master.state.doors import AT_ONCE, KINDS, MAX_PEERS, Door, Target, Way
from rossec.ros.settings import build_door

_TEXT_LIMIT: Final = 255
_MAX_COUNT: Final = 1 << 53
_WAY: Final = frozenset(Way._fields)


def kind(label: str) -> Check:
    """What a target is."""

    def check(value: object, _caller: str) -> str:
        if value not in KINDS or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be one of {', '.join(KINDS)}")
        return value

    return check


def name(label: str) -> Check:
    """An absolute name, well-formed."""

    def check(value: object, _caller: str) -> str:
        try:
            return check_name(value if isinstance(value, str) else "")
        except NameRefused as error:
            raise ArgumentRefused(f"ERROR: parameter [{label}]: {error}") from error

    return check


def doors(label: str) -> Check:
    """`[peer, kind, name, host, port]` for each door, as doors by target."""

    def check(value: object, _caller: str) -> dict[Target, Door]:
        if not isinstance(value, list) or len(value) > AT_ONCE:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {AT_ONCE}")
        found = [_door(each) for each in value]
        if None in found:
            raise ArgumentRefused(f"ERROR: parameter [{label}] has a door that is not one")
        return dict(each for each in found if each is not None)

    return check


def ways(label: str) -> Check:
    """A struct of the fields of `Way` for the label of each peer."""

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
        str(value["state"]), float(value["rtt_ms"]), int(value["retransmissions"]),
        str(value["router"]), int(value["streams"]),
    )  # fmt: skip


def _is_count(value: object) -> bool:
    """Whether it is a number that is not negative; neither is infinity, which has no integer."""
    return type(value) in (int, float) and 0 <= value <= _MAX_COUNT  # type: ignore[operator]


def _is_label(value: object) -> bool:
    try:
        check_label(value if isinstance(value, str) else "")
    except NameRefused:
        return False
    return True
