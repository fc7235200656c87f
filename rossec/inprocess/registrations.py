"""What the master answered rospy: what it has registered, the publishers and nodes it named last.

Pure, thread-safe. A registration that the master refused is repeated when there is a new grant.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Final

from rossec.errors import ConfigurationError
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.registrations import UNREGISTERS, RegistrationTable
from rossec.ros.settings import parse_uri

REGISTRATIONS: Final[Mapping[str, object]] = {
    "registerPublisher": [], "registerSubscriber": [], "registerService": 1,
}  # fmt: skip
"""Registrations, each with the value a master without other nodes answers."""
REFUSED: Final = "rossec: "
_NODES: Final = 1024  # that were looked up


class Registrations:
    """The registrations of one node.

    Attributes:
        table: what is registered, or was refused.
        publishers: those that the master names, by topic.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self.table = RegistrationTable()
        self.publishers = PublisherGrace(now)
        self._nodes: dict[tuple[str, int], None] = {}

    def record(self, method: str, params: Sequence[object], answer: object) -> None:
        """Record a call of the program and the master's answer."""
        if method in UNREGISTERS:  # whatever the answer: the program is done with it
            self.table.record(method, params)
        match answer:
            case [1, _, value]:
                self.table.record(method, params)
                if method == "registerSubscriber":
                    self.set_publishers(str(params[1]), value)
                elif method == "lookupNode" and isinstance(value, str):
                    self._add_node(value)
            case [_, str(status), _] if status.startswith(REFUSED):
                self.table.record(method, params, refused=True)
            case _:
                pass

    def set_publishers(self, topic: str, uris: object) -> None:
        """Store the publishers of a topic that the master names."""
        if isinstance(uris, Iterable):
            self.publishers.update(topic, [uri for uri in uris if isinstance(uri, str)])

    def is_publisher(self, topic: str, uri: str) -> bool:
        """Whether the master still names `uri`, or may name it again."""
        return uri in self.publishers.to_follow(topic)

    def _add_node(self, uri: str) -> None:
        with suppress(ConfigurationError):
            self._nodes[parse_uri(uri)] = None
        if len(self._nodes) > _NODES:
            del self._nodes[next(iter(self._nodes))]

    def is_node(self, address: tuple[str, int]) -> bool:
        """Whether the master has named a node at this host and port."""
        return address in self._nodes
