"""The publishers of one topic at its origin, and what their messages are. Pure.

A topic has one type, and the definition of the first publisher counts. While a publisher of that
type is connected, one of another type is refused, as every subscriber in ROS refuses it. When none
is, the type has changed: what was said of it here is wrong, and the topic has to begin again.
"""

from grants.errors import DefinitionRefused
from rossec.errors import ConnectionHeaderRefused
from rossec.node.raw_subscriber import RawSource
from rossec.participant.definitions import Definition


class TypeChanged(ConnectionHeaderRefused):
    """The topic has another type at its origin than was said here."""


class Sources:
    """Those that are connected."""

    def __init__(self) -> None:
        self.type: Definition | None = None
        self._connected: set[RawSource] = set()

    def __len__(self) -> int:
        return len(self._connected)

    @property
    def latching(self) -> bool:
        """Whether there is one source, and it latches: of several none has the last word."""
        return len(self._connected) == 1 and next(iter(self._connected)).latching

    def connect(self, source: RawSource) -> bool:
        """Add a source; returns whether it is the first to say the type.

        Raises:
            TypeChanged: no source of the known type is connected, and this is of another.
            ConnectionHeaderRefused: a source of another type is connected.
        """
        is_first = self.type is None
        if self.type is not None and not same_type(self.type, source.type):
            told = f"{source.peer} publishes {source.type.name} ({source.type.md5sum})"
            kind = ConnectionHeaderRefused if self._connected else TypeChanged
            raise kind(f"{told}, and not {self.type.name} ({self.type.md5sum})")
        self.type = self.type or source.type
        self._connected.add(source)
        return is_first

    def disconnect(self, source: RawSource) -> None:
        """Remove a source."""
        self._connected.discard(source)


def same_type(one: Definition, other: Definition) -> bool:
    """Whether messages of both have the same bytes: the md5sum alone does not say it."""
    if (one.name, one.md5sum) != (other.name, other.md5sum):
        return False
    return one.definition == other.definition or _digest(one) == _digest(other)


def _digest(kind: Definition) -> bytes | str:
    """What identifies a layout; the text, if it is no definition."""
    try:
        return kind.layout.digest
    except (DefinitionRefused, ConnectionHeaderRefused):
        return kind.definition
