"""The master's journals, from which a restarted one restores parameters and deposited grants. Pure.

A record is the length and the CRC-32 of its content (4 bytes each, big endian), then the content. A
record that is truncated or damaged ends a journal: it was being written when the power failed. The
CRC detects accidents, not attacks: the file is writable for its owner alone. What has expired or is
revoked needs no record: it is left out when the journal is read.
"""

import zlib
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple, TypeVar

from rossec.errors import XmlRpcRefused
from rossec.master.state.parameters import ParameterMissing, Parameters, exceeds
from rossec.ros import names, xmlrpc

_HEADER_SIZE: Final = 8
PARAMETERS_MAGIC: Final = b"rossec parameters 1\n"
_SET: Final = "setParam"
_DELETE: Final = "deleteParam"
_PIECE: Final = 256 * 1024  # encoded in some milliseconds
DEPOSITS_MAGIC: Final = b"rossec deposits 1\n"
ID_SIZE: Final = 16
_GRANT: Final = b"G"
_HELD: Final = b"H"

T = TypeVar("T")


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


def _decode(data: bytes, magic: bytes, read: Callable[[bytes], T | None]) -> tuple[list[T], int]:
    # The changes, and how many bytes of `data` hold them.
    changes, valid = list[T](), len(magic) if data.startswith(magic) else 0
    for content, end in contents(data, valid) if valid else ():
        change = read(content)
        if change is None:
            break
        changes.append(change)
        valid = end
    return changes, valid


class ParameterChange(NamedTuple):
    """A parameter or a tree was set, or, with `deleted`, deleted; then `value` is unused."""

    key: str
    value: object = None
    deleted: bool = False


def encode_parameter(change: ParameterChange) -> bytes:
    # The call that makes the change, as XML-RPC: every value a client can set can be written, and
    # reading applies the same limits.
    if change.deleted:
        return frame(xmlrpc.dump_call(_DELETE, (change.key,)))
    return frame(xmlrpc.dump_call(_SET, (change.key, change.value)))


def decode_parameters(data: bytes) -> tuple[list[ParameterChange], int]:
    def read(content: bytes) -> ParameterChange | None:
        try:
            call = xmlrpc.load_call(content, limit=len(content))
        except XmlRpcRefused:
            return None
        match call:
            case (method, (str() as key, value)) if method == _SET:
                return ParameterChange(key, value)
            case (method, (str() as key,)) if method == _DELETE:
                return ParameterChange(key, deleted=True)
        return None

    return _decode(data, PARAMETERS_MAGIC, read)


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
    # The shortest journal piece by piece; the parameters may change between two of them. Each piece is of
    # what is set when it is made. So the pieces are a journal of all parameters if each change is written
    # behind the pieces that were made before it.
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


class GrantDeposited(NamedTuple):
    data: bytes


class GrantHeld(NamedTuple):
    grant_id: bytes


DepositChange = GrantDeposited | GrantHeld


def encode_deposit(change: DepositChange) -> bytes:
    match change:
        case GrantDeposited(data):
            return frame(_GRANT + data)
        case GrantHeld(grant_id):
            return frame(_HELD + grant_id)


def decode_deposits(data: bytes) -> tuple[list[DepositChange], int]:
    def read(content: bytes) -> DepositChange | None:
        letter, rest = content[:1], content[1:]
        if letter == _GRANT and rest:
            return GrantDeposited(rest)
        return GrantHeld(rest) if letter == _HELD and len(rest) == ID_SIZE else None

    return _decode(data, DEPOSITS_MAGIC, read)
