"""What rospy registered with the master, to repeat it after a restart or with a new grant.

Pure. rospy registers once and never again; a master that was restarted would not know the node.
A registration that the master refused is stored as well, and repeated when there is a new grant.
Also here: the publishers and nodes that the master named last.
Thread-safe: iterations are over a copy, which is made in one step.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Final

from rossec.errors import ConfigurationError
from rossec.participant.publisher_grace import PublisherGrace
from rossec.ros.settings import parse_uri

_UNDO: Final = {
    "unregisterPublisher": "registerPublisher",
    "unregisterSubscriber": "registerSubscriber",
    "unregisterService": "registerService",
    "unsubscribeParam": "subscribeParam",
}
_DO: Final = frozenset(_UNDO.values())
REGISTRATIONS: Final[Mapping[str, object]] = {
    "registerPublisher": [], "registerSubscriber": [], "registerService": 1,
}  # fmt: skip
"""Registrations, each with the value a master without other nodes answers."""
REFUSED: Final = "rossec: "
_NODES: Final = 1024  # that were looked up

# What rospy registers by itself. A refusal is no warning: the program works without.
_OWN_TOPICS: Final = ("/rosout",)
_OWN_SERVICES: Final = ("/get_loggers", "/set_logger_level")
_OWN_PARAMETERS: Final = (
    "/tcp_keepalive", "/use_sim_time", "/enable_statistics", "/rosout_disable_topics_generation",
)  # fmt: skip

Call = tuple[str, tuple[object, ...]]


class Registrations:
    """The registrations of one node.

    Attributes:
        publishers: those that the master names, by topic.
    """

    def __init__(self, name: str, now: Callable[[], float]) -> None:
        self._name = name
        self.publishers = PublisherGrace(now)
        self._calls: dict[tuple[str, object], tuple[object, ...]] = {}
        self._refused: set[tuple[str, object]] = set()
        self._nodes: dict[tuple[str, int], None] = {}

    def record(self, method: str, params: Sequence[object], answer: object) -> None:
        """Record a call of the program and the master's answer."""
        done = _UNDO.get(method)
        if done is not None:
            key = _key(done, params)
            self._calls.pop(key, None)
            self._refused.discard(key)
        match method, answer:
            case "lookupNode", [1, _, str(uri)]:
                self._add_node(uri)
            case _:
                pass
        if method not in _DO:
            return
        key = _key(method, params)
        match answer:
            case [1, _, value]:
                self._calls[key] = tuple(params)
                self._refused.discard(key)
                if method == "registerSubscriber":
                    self.set_publishers(str(params[1]), value)
            case [_, str(status), _] if status.startswith(REFUSED):
                self._calls[key] = tuple(params)
                self._refused.add(key)
            case _:
                pass

    def all(self) -> list[Call]:
        """Every registration, in the order they were made."""
        return [(method, params) for (method, _), params in self._calls.copy().items()]

    def refused(self) -> list[Call]:
        """Those the master refused: the node has no right."""
        calls = self._calls.copy().items()
        return [(key[0], params) for key, params in calls if key in self._refused]

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

    def is_rospys_own(self, method: str, params: Sequence[object]) -> bool:
        """Whether rospy makes this call by itself, not for the program."""
        match method, tuple(params):
            case "registerPublisher", (_, topic, *_):
                return topic in _OWN_TOPICS
            case "registerService", (_, service, *_):
                return service in {self._name + own for own in _OWN_SERVICES}
            case "getParam", (_, key):
                return key in _OWN_PARAMETERS
            case "subscribeParam", (_, _, key):
                return key in _OWN_PARAMETERS
            case _:
                return False


def _key(method: str, params: Sequence[object]) -> tuple[str, object]:
    position = 2 if method == "subscribeParam" else 1
    return method, params[position] if len(params) > position else None
