"""Checks of the arguments of master calls; the texts are stock rosmaster's (validators.py). Pure.

Stricter than stock, because rights are matched on names: a topic, service or parameter must have a
well-formed ROS name after it is resolved, and a URI must have a host and a port to connect to. What
a relay of the own domain says is shown to people and given to nodes: its forwarded ports are well-formed
addresses, and everything has a limit.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeVar

from ca.errors import NameRefused
from ca.names import check_label, check_name, check_pattern
from rossec.master.rights.renewals import OFFER_LIMIT, Settlement
from rossec.master.state.forwarded_ports import AT_ONCE, KINDS, MAX_PEERS, ForwardedPort, PeerWay, Target
from rossec.master.state.registry import is_connectable, is_type_name
from rossec.ros import names

KEY_LIMIT: Final = 255
_TEXT_LIMIT: Final = 255
_DIGEST: Final = 32  # bytes of a SHA-256
_MAX_COUNT: Final = 1 << 53

T = TypeVar("T")

# Takes the argument and the caller's name; returns the canonical argument or raises
Check = Callable[[object, str], object]


class ArgumentRefused(Exception):
    """An argument is invalid; the text is the status to answer with."""


def anything(value: object, caller: str) -> object:  # noqa: ARG001 - the signature of a Check
    return value


def _check(check: Callable[[object, str, str], object]) -> Callable[[str], Check]:
    # A check of an argument that is called `label` in texts.
    return lambda label: lambda value, caller: check(value, caller, label)


@_check
def key(value: object, caller: str, label: str) -> str:
    resolved = names.resolve(_text(value, label), caller)
    if len(resolved) > KEY_LIMIT:
        raise ArgumentRefused(f"ERROR: parameter [{label}] is too long")
    return resolved if resolved == names.SEPARATOR else _well_formed(resolved, label)


@_check
def search_key(value: object, _caller: str, label: str) -> str:
    return _text(value, label)[:KEY_LIMIT]  # not resolved: the search does that


@_check
def node(value: object, caller: str, label: str) -> str:
    return names.resolve(_plain_name(value, label), caller)


@_check
def topic(value: object, caller: str, label: str) -> str:
    plain = _plain_name(value, label)
    if plain == names.SEPARATOR:
        raise ArgumentRefused(f"ERROR: parameter [{label}] cannot be the global namespace")
    return _well_formed(names.resolve(plain, caller), label)


@_check
def subgraph(value: object, caller: str, label: str) -> str:
    if not isinstance(value, str):
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be a string")
    return names.resolve(value, caller) if value else ""


@_check
def type_name(value: object, _caller: str, label: str) -> str:
    if not value or not isinstance(value, str):
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be a non-empty string")
    if value != names.ANY_TYPE and not is_type_name(value):
        raise ArgumentRefused(f"ERROR: parameter [{label}] is not a valid package resource name")
    return value


def uri(label: str, scheme: str) -> Check:
    def check(value: object, _caller: str) -> str:
        if not value or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not an XMLRPC URI")
        if not is_connectable(value, scheme):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not an RPC URI")
        return value

    return check


def _is(kind: str, is_valid: Callable[[object], bool]) -> Callable[[str], Check]:
    @_check
    def check(value: object, _caller: str, label: str) -> object:
        if not is_valid(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be {kind}")
        return value

    return check


text = _is("a string", lambda value: isinstance(value, str))
number = _is("a number", lambda value: type(value) is int and value >= 0)
binary = _is("base64", lambda value: isinstance(value, bytes))
kind = _is(f"one of {', '.join(KINDS)}", lambda value: value in KINDS)
not_none = _is("specified", lambda value: value is not None)  # XML-RPC's nil stock clients cannot send either


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


@_check
def name(value: object, _caller: str, label: str) -> str:
    try:
        return check_name(value if isinstance(value, str) else "")
    except NameRefused as error:
        raise ArgumentRefused(f"ERROR: parameter [{label}]: {error}") from error


@_check
def forwarded_ports(value: object, _caller: str, label: str) -> dict[Target, ForwardedPort]:
    if not isinstance(value, list) or len(value) > AT_ONCE:
        raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {AT_ONCE}")
    found: dict[Target, ForwardedPort] = {}
    for each in value:
        match each:
            case [str() as peer, str() as what, str() as target, str() as host, int() as port]:
                with suppress(NameRefused, ValueError):
                    check_label(peer)
                    check_name(target)
                    if is_connectable(names.build_forwarded_port(host, port), "http") and what in KINDS:
                        found[Target(peer, what, target)] = ForwardedPort(host, port)
                        continue
            case _:
                pass
        raise ArgumentRefused(f"ERROR: parameter [{label}] has a forwarded port that is not one")
    return found


@_check
def ways(value: object, _caller: str, label: str) -> dict[str, PeerWay]:
    if not isinstance(value, dict) or len(value) > MAX_PEERS:
        raise ArgumentRefused(f"ERROR: parameter [{label}] has at most {MAX_PEERS} peers")
    found = {peer: _way(peer, way) for peer, way in value.items()}
    if None in found.values():
        raise ArgumentRefused(f"ERROR: parameter [{label}] has a way that is not one")
    return {peer: way for peer, way in found.items() if way is not None}


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
