"""Fields of a TCPROS connection header as peers write them: strictly read, never trusted."""

from collections.abc import Mapping

from ca.certificates import Identity
from rossec.errors import CallerMismatch, ConnectionHeaderRefused

Fields = dict[str, bytes]


def check_caller(fields: Mapping[str, bytes], peer: Identity) -> None:
    """Compare the `callerid` of a peer with its certificate.

    Raises:
        CallerMismatch: its certificate does not cover it.
        ConnectionHeaderRefused: the field is missing.
    """
    caller = text(fields, "callerid")
    if not peer.covers(caller):
        raise CallerMismatch(
            f"a node certified as {peer.name} calls itself {caller}",
            "start it under the name it was enrolled with",
        )


def text(fields: Mapping[str, bytes], key: str) -> str:
    """Field `key` as printable text of at most 4096 characters.

    Raises:
        ConnectionHeaderRefused: missing, not UTF-8, or with control characters.
    """
    value = fields.get(key)
    if value is None:
        raise ConnectionHeaderRefused(f"the connection header has no {key!r}")
    try:
        decoded = value.decode()
    except UnicodeDecodeError:
        raise ConnectionHeaderRefused(f"the connection header's {key!r} is not text") from None
    if not decoded.isprintable() and key != "error":
        raise ConnectionHeaderRefused(f"the connection header's {key!r} holds control characters")
    return "".join(char if char.isprintable() else " " for char in decoded)[:4096]
