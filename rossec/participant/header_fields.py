"""Fields of a TCPROS connection header as peers write them: strictly read, never trusted.

Names on the wire are those at their origin: an alias that arrives is refused.
"""

from collections.abc import Mapping

from ca.certificates import Identity
from ca.domains.aliases import is_alias, shown
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
            f"a node certified as {shown(peer.name)} calls itself {caller}",
            "start it under the name it was enrolled with",
        )


def refuse_on_wire(name: str) -> str:
    """Return `name`, which a peer sent, unless it is below `/remote`.

    Raises:
        ConnectionHeaderRefused: it is.
    """
    if is_alias(name):
        raise ConnectionHeaderRefused(
            f"{name} is an alias where it was written, and no name on the wire",
            "a peer is asked by the origin's name: does the caller run an older rossec?",
        )
    return name


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
