"""Runs layers against a script: the expected commands, and the event that answers each."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import TypeVar

from ca.certificates import Identity
from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations
from rossec.participant.access import Access
from rossec.participant.host_types import known_type
from rossec.participant.registrations import PublisherGrace
from rossec.sidecar.core.layers import AgentState, Command, EndpointMap, Event
from tests.support.domains import alone
from tests.support.site import Site

Outcome = TypeVar("Outcome")
HOST = "robot.local"
MASTER_URI = "http://127.0.0.1:4000/"


def run_layer(
    layer: Generator[Command, Event, Outcome], *script: tuple[Command, Event | Exception]
) -> Outcome:
    """Run `layer`; it must yield exactly these commands, in this order. Returns its outcome."""
    left = list(script)
    try:
        command = next(layer)
        while left:
            expected, event = left.pop(0)
            assert command == expected
            command = layer.throw(event) if isinstance(event, Exception) else layer.send(event)
    except StopIteration as done:
        assert not left, "it ended before the script did"
        outcome: Outcome = done.value
        return outcome
    raise AssertionError(f"one command more: {command}")


@dataclass
class AgentSetup:
    """Two identities of one site, an agent state for the first, and fresh revocation data."""

    site: Site
    name: str = "/robot"
    wildcard: bool = False
    time: float = 0.0  # the clock of publisher grace periods

    def __post_init__(self) -> None:
        self.site.enroll(self.name, wildcard=self.wildcard)
        self.agent = AgentState(
            self.identity(self.name),
            self.access(self.name),
            EndpointMap(HOST),
            MASTER_URI,
            known_type,
            PublisherGrace(lambda: self.time),
        )

    def identity(self, name: str) -> Identity:
        return self.site.identity(name)

    def access(self, name: str) -> Access:
        """The access of `name`, with a revocation list that was confirmed now."""
        held = Revocations(self.site.anchor.public_key)
        data = self.site.authority.store.newest_list()
        assert data is not None
        now = self.site.now()
        held.update(data, now)
        assert held.current is not None
        held.confirm(Timestamp(held.current.seq, digest(data), now, 30), now)
        return Access(alone(self.site.anchor, held), self.site.enroll(name).grants())
