"""The records of the master's journals. Pure.

A record is the length and the CRC-32 of its content (4 bytes each, big endian), then the content. A
record that is truncated or damaged ends a journal: it was being written when the power failed. The
CRC detects accidents, not attacks: the file is writable for its owner alone.

The journal of parameter changes, from which a restarted master restores them. Pure.

A record (`journal_records`) holds the call that makes the change, as XML-RPC: every value a client
can set can be written, and reading applies the same limits.

The journal of deposited grants, from which a restarted master restores them. Pure.

The content of a record (`journal_records`) is one letter and what it is about: `G` and a grant as
signed, which was deposited; `H` and the id of a grant, which its holder has presented. What has
expired or is revoked needs no record: it is left out when the journal is read.
"""

import zlib
from collections.abc import Iterator
from typing import Final, NamedTuple

from rossec.errors import XmlRpcRefused
from rossec.master.state.parameters import ParameterMissing, Parameters, exceeds
from rossec.ros import names, xmlrpc

_HEADER_SIZE: Final = 8


def frame(content: bytes) -> bytes:
    return len(content).to_bytes(4) + zlib.crc32(content).to_bytes(4) + content


def contents(data: bytes, at: int) -> Iterator[tuple[bytes, int]]:
    while len(data) - at >= _HEADER_SIZE:
        begin = at + _HEADER_SIZE
        at = begin + int.from_bytes(data[at : at + 4])
        content = data[begin:at]
        if len(data) < at or zlib.crc32(content) != int.from_bytes(data[begin - 4 : begin]):
            return
        yield content, at


PARAMETERS_MAGIC: Final = b"rossec parameters 1\n"
_SET: Final = "setParam"
_DELETE: Final = "deleteParam"
_PIECE: Final = 256 * 1024  # encoded in some milliseconds


class ParameterChange(NamedTuple):
    """A parameter or a tree was set, or, with `deleted`, deleted; then `value` is unused."""

    key: str
    value: object = None
    deleted: bool = False


def encode_parameter(change: ParameterChange) -> bytes:
    if change.deleted:
        call = xmlrpc.dump_call(_DELETE, (change.key,))
    else:
        call = xmlrpc.dump_call(_SET, (change.key, change.value))
    return frame(call)


def decode_parameters(data: bytes) -> tuple[list[ParameterChange], int]:
    changes: list[ParameterChange] = []
    valid = len(PARAMETERS_MAGIC) if data.startswith(PARAMETERS_MAGIC) else 0
    if valid:
        for change, end in _parameter_records(data, valid):
            changes.append(change)
            valid = end
    return changes, valid


def _parameter_records(data: bytes, at: int) -> Iterator[tuple[ParameterChange, int]]:
    for call, end in contents(data, at):
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
    for change in changes:
        try:
            if change.deleted:
                parameters.delete(change.key)
            else:
                parameters.set(change.key, change.value)
        except (ParameterMissing, TypeError, ValueError):
            continue


def snapshot(parameters: Parameters) -> bytes:
    return b"".join(pieces(parameters))


def pieces(parameters: Parameters) -> Iterator[bytes]:
    """The shortest journal piece by piece; the parameters may change between two of them.

    Each piece is of what is set when it is made. So the pieces are a journal of all parameters if
    each change is written behind the pieces that were made before it.
    """
    yield PARAMETERS_MAGIC
    tree = parameters.get("/")
    for name in tuple(tree) if isinstance(tree, dict) else ():
        yield from _pieces(parameters, names.join("/", name))


def _pieces(parameters: Parameters, key: str) -> Iterator[bytes]:
    try:
        value = parameters.get(key)
    except ParameterMissing:
        return
    if not isinstance(value, dict) or not exceeds(value, _PIECE):
        yield encode_parameter(ParameterChange(key, value))
        return
    below = tuple(value)
    yield encode_parameter(ParameterChange(key, {}))
    for name in below:
        yield from _pieces(parameters, names.join(key, name))


DEPOSITS_MAGIC: Final = b"rossec deposits 1\n"
ID_SIZE: Final = 16
_GRANT: Final = b"G"
_HELD: Final = b"H"


class GrantDeposited(NamedTuple):
    """The grant `data`, as signed, was deposited."""

    data: bytes


class GrantHeld(NamedTuple):
    """The holder of the deposited grant `grant_id` has presented it."""

    grant_id: bytes


DepositChange = GrantDeposited | GrantHeld


def encode_deposit(change: DepositChange) -> bytes:
    match change:
        case GrantDeposited(data):
            return frame(_GRANT + data)
        case GrantHeld(grant_id):
            return frame(_HELD + grant_id)


def decode_deposits(data: bytes) -> tuple[list[DepositChange], int]:
    changes: list[DepositChange] = []
    valid = len(DEPOSITS_MAGIC) if data.startswith(DEPOSITS_MAGIC) else 0
    if valid:
        for change, end in _deposit_records(data, valid):
            changes.append(change)
            valid = end
    return changes, valid


def _deposit_records(data: bytes, at: int) -> Iterator[tuple[DepositChange, int]]:
    for content, end in contents(data, at):
        letter, rest = content[:1], content[1:]
        if letter == _GRANT and rest:
            yield GrantDeposited(rest), end
        elif letter == _HELD and len(rest) == ID_SIZE:
            yield GrantHeld(rest), end
        else:
            return
