"""Validation of the arguments of master calls; the texts are stock rosmaster's (validators.py).

Stricter than stock, because rights are matched on names: a topic, service or parameter must have a
well-formed ROS name after it is resolved, and a URI must have a host and a port to connect to.
"""

from collections.abc import Callable
from typing import Final

from ca.errors import NameRefused
from ca.names import check_name
from ca.patterns import check_pattern
from rossec.master.state.addresses import is_connectable
from rossec.ros import names

KEY_LIMIT: Final = 255

Check = Callable[[object, str], object]
"""Takes the argument and the caller's name; returns the canonical argument or raises."""


class ArgumentRefused(Exception):
    """An argument is invalid; the text is the status to answer with."""


def anything(value: object, caller: str) -> object:  # noqa: ARG001 - the signature of a Check
    """Any value."""
    return value


def not_none(label: str) -> Check:
    """Any value but XML-RPC's nil, which stock clients cannot send either."""

    def check(value: object, _caller: str) -> object:
        if value is None:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be specified")
        return value

    return check


def key(label: str) -> Check:
    """A parameter name, resolved and well-formed, or the root: grants cover nothing else."""

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
    """A name, resolved."""

    def check(value: object, caller: str) -> str:
        return names.resolve(_plain_name(value, label), caller)

    return check


def topic(label: str) -> Check:
    """The name of a topic or service, resolved and well-formed."""

    def check(value: object, caller: str) -> str:
        plain = _plain_name(value, label)
        if plain == names.SEPARATOR:
            raise ArgumentRefused(f"ERROR: parameter [{label}] cannot be the global namespace")
        return _well_formed(names.resolve(plain, caller), label)

    return check


def subgraph(label: str) -> Check:
    """Empty, or a namespace, resolved."""

    def check(value: object, caller: str) -> str:
        if not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a string")
        return names.resolve(value, caller) if value else ""

    return check


def type_name(label: str) -> Check:
    """`*` or `package/Type`."""

    def check(value: object, _caller: str) -> str:
        if not value or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a non-empty string")
        if value != names.ANY_TYPE and not _is_resource_name(value):
            text = f"ERROR: parameter [{label}] is not a valid package resource name"
            raise ArgumentRefused(text)
        return value

    return check


def uri(label: str, scheme: str) -> Check:
    """`http://host:port/` of a slave API or `rosrpc://host:port` of a service."""

    def check(value: object, _caller: str) -> str:
        if not value or not isinstance(value, str):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not an XMLRPC URI")
        if not is_connectable(value, scheme):
            raise ArgumentRefused(f"ERROR: parameter [{label}] is not an RPC URI")
        return value

    return check


def text(label: str) -> Check:
    """Text, also empty."""
    return _checked(label, "a string", lambda value: isinstance(value, str))


def number(label: str) -> Check:
    """A non-negative integer."""
    return _checked(label, "a number", lambda value: type(value) is int and value >= 0)


def binary(label: str) -> Check:
    """XML-RPC base64."""
    return _checked(label, "base64", lambda value: isinstance(value, bytes))


def _checked(label: str, kind: str, is_valid: Callable[[object], bool]) -> Check:
    def check(value: object, _caller: str) -> object:
        if not is_valid(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be {kind}")
        return value

    return check


def binaries(label: str, most: int) -> Check:
    """A list of at most `most` XML-RPC base64 values."""

    def check(value: object, _caller: str) -> list[bytes]:
        if not isinstance(value, list) or len(value) > most:
            raise ArgumentRefused(f"ERROR: parameter [{label}] must be a list of at most {most}")
        items = [item for item in value if isinstance(item, bytes)]
        if len(items) != len(value):
            raise ArgumentRefused(f"ERROR: parameter [{label}] must hold base64 only")
        return items

    return check


def patterns(label: str, most: int) -> Check:
    """A list of at most `most` patterns of names; an empty one matches nothing."""

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
