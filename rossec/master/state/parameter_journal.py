"""The journal of parameter changes, from which a restarted master restores them. Pure.

A record (`journal_records`) holds the call that makes the change, as XML-RPC: every value a client
can set can be written, and reading applies the same limits.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from rossec.errors import XmlRpcRefused
from rossec.master.state import journal_records
from rossec.master.state.parameter_values import exceeds
from rossec.master.state.parameters import ParameterMissing, Parameters
from rossec.ros import names, xmlrpc

MAGIC: Final = b"rossec parameters 1\n"
_SET: Final = "setParam"
_DELETE: Final = "deleteParam"
_PIECE: Final = 256 * 1024  # encoded in some milliseconds


class ParameterChange(NamedTuple):
    """A parameter or a tree was set, or, with `deleted`, deleted; then `value` is unused."""

    key: str
    value: object = None
    deleted: bool = False


def encode(change: ParameterChange) -> bytes:
    """One record.

    Raises:
        XmlRpcRefused: XML-RPC cannot encode the value; no client can have set it.
    """
    if change.deleted:
        call = xmlrpc.dump_call(_DELETE, (change.key,))
    else:
        call = xmlrpc.dump_call(_SET, (change.key, change.value))
    return journal_records.frame(call)


def decode(data: bytes) -> tuple[list[ParameterChange], int]:
    """The changes in a journal, and the length of its undamaged part."""
    changes: list[ParameterChange] = []
    valid = len(MAGIC) if data.startswith(MAGIC) else 0
    if valid:
        for change, end in _records(data, valid):
            changes.append(change)
            valid = end
    return changes, valid


def _records(data: bytes, at: int) -> Iterator[tuple[ParameterChange, int]]:
    for call, end in journal_records.contents(data, at):
        try:
            change = _change(xmlrpc.load_call(call, limit=len(call)))
        except XmlRpcRefused:
            return
        if change is None:
            return
        yield change, end


def _change(call: xmlrpc.Call) -> ParameterChange | None:
    match call:
        case (method, (str() as key, value)) if method == _SET:
            return ParameterChange(key, value)
        case (method, (str() as key,)) if method == _DELETE:
            return ParameterChange(key, deleted=True)
        case _:
            return None


def replay(parameters: Parameters, changes: list[ParameterChange]) -> None:
    """Apply the changes in order; one that fails now failed then, too."""
    for change in changes:
        try:
            if change.deleted:
                parameters.delete(change.key)
            else:
                parameters.set(change.key, change.value)
        except (ParameterMissing, TypeError, ValueError):
            continue


def snapshot(parameters: Parameters) -> bytes:
    """The shortest journal of these parameters."""
    return b"".join(pieces(parameters))


def pieces(parameters: Parameters) -> Iterator[bytes]:
    """The shortest journal piece by piece; the parameters may change between two of them.

    Each piece is of what is set when it is made. So the pieces are a journal of all parameters if
    each change is written behind the pieces that were made before it.
    """
    yield MAGIC
    tree = parameters.get("/")
    for name in tuple(tree) if isinstance(tree, dict) else ():
        yield from _pieces(parameters, names.join("/", name))


def _pieces(parameters: Parameters, key: str) -> Iterator[bytes]:
    try:
        value = parameters.get(key)
    except ParameterMissing:
        return
    if not isinstance(value, dict) or not exceeds(value, _PIECE):
        yield encode(ParameterChange(key, value))
        return
    below = tuple(value)
    yield encode(ParameterChange(key, {}))
    for name in below:
        yield from _pieces(parameters, names.join(key, name))
