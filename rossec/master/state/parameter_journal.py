"""Parameter changes as records: what a master writes down to survive its own death. Pure.

A record is length and CRC-32 (4 bytes each, big endian), then the call that makes the change, as
XML-RPC: what a client could set can be written, and what is read passes the same limits. A record
that is cut short or damaged ends the journal: it was being written when the power failed. The CRC
finds accidents; whoever can write the file needs no right any more.
"""

import zlib
from collections.abc import Iterator
from typing import Final, NamedTuple

from rossec.errors import XmlRpcRefused
from rossec.master.state.parameters import ParameterMissing, Parameters
from rossec.ros import xmlrpc

MAGIC: Final = b"rossec parameters 1\n"
_SET: Final = "setParam"
_DELETE: Final = "deleteParam"
_HEAD: Final = 8


class ParameterChange(NamedTuple):
    """A parameter, or a tree, was set; `deleted`: it is gone, and `value` means nothing."""

    key: str
    value: object = None
    deleted: bool = False


def encode(change: ParameterChange) -> bytes:
    """One record.

    Raises:
        XmlRpcRefused: the value cannot be carried; no client can have set it.
    """
    if change.deleted:
        call = xmlrpc.dump_call(_DELETE, (change.key,))
    else:
        call = xmlrpc.dump_call(_SET, (change.key, change.value))
    return len(call).to_bytes(4) + zlib.crc32(call).to_bytes(4) + call


def decode(data: bytes) -> tuple[list[ParameterChange], int]:
    """The changes in a journal, and how many of its bytes are good."""
    changes: list[ParameterChange] = []
    good = len(MAGIC) if data.startswith(MAGIC) else 0
    if good:
        for change, end in _records(data, good):
            changes.append(change)
            good = end
    return changes, good


def _records(data: bytes, at: int) -> Iterator[tuple[ParameterChange, int]]:
    while len(data) - at >= _HEAD:
        length = int.from_bytes(data[at : at + 4])
        call = data[at + _HEAD : at + _HEAD + length]
        if len(call) != length or zlib.crc32(call) != int.from_bytes(data[at + 4 : at + _HEAD]):
            return
        at += _HEAD + length
        try:
            change = _change(xmlrpc.load_call(call, limit=length))
        except XmlRpcRefused:
            return
        if change is None:
            return
        yield change, at


def _change(call: xmlrpc.Call) -> ParameterChange | None:
    match call:
        case (method, (str() as key, value)) if method == _SET:
            return ParameterChange(key, value)
        case (method, (str() as key,)) if method == _DELETE:
            return ParameterChange(key, deleted=True)
        case _:
            return None


def replay(parameters: Parameters, changes: list[ParameterChange]) -> None:
    """Make the changes again, in their order; one that is impossible now was so then."""
    for change in changes:
        try:
            if change.deleted:
                parameters.delete(change.key)
            else:
                parameters.set(change.key, change.value)
        except (ParameterMissing, TypeError, ValueError):
            continue


def snapshot(parameters: Parameters) -> bytes:
    """A journal that leads to these parameters by the shortest way."""
    tree = parameters.get("/")
    keys = list(tree) if isinstance(tree, dict) else []
    records = (encode(ParameterChange(f"/{key}", parameters.get(f"/{key}"))) for key in keys)
    return MAGIC + b"".join(records)
