"""What a decision means for the two messages of a call: one guard for each.

Pure. A restriction written for the type of the response (`std_srvs/TriggerResponse`) holds for
responses; every other one holds for requests, so that a rate or a time counts once per call, and
one that is written for any other type refuses the connection. Both ends use this: the server with
the caller's right to call, the client with the server's right to provide.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from grants.decision import Decision
from grants.filters.codegen import Buffer
from grants.guard import Guard, needed_keys
from grants.memory import MemoryScope
from rossec.errors import ServiceRefused
from rossec.participant.service_types import ServiceType

Pieces = Sequence[Buffer]


class ServiceGuard:
    """Treats the requests and responses of one connection.

    Args:
        filter_key: finds a key for pseudonyms by its name.
        recall: finds what earlier connections of the same key have used up.

    Raises:
        GrantError: a restriction was written for another type.
        ConfigurationError: a key for pseudonyms cannot be read.
    """

    def __init__(
        self,
        kind: ServiceType,
        decision: Decision,
        filter_key: Callable[[str], bytes],
        recall: MemoryScope,
    ) -> None:
        keys = {name: filter_key(name) for name in needed_keys(decision.restrictions)}
        restrictions = decision.restrictions
        back = tuple(item for item in restrictions if item.type == kind.response.name)
        there = tuple(item for item in restrictions if item.type != kind.response.name)
        self._name = decision.name
        asked, answered = (replace(decision, restrictions=some) for some in (there, back))
        self._request = Guard(kind.request_layout, asked, keys, recall)
        self._response = Guard(kind.response_layout, answered, keys, recall.child("response"))

    def request(self, data: Buffer, now: int) -> Pieces:
        """The request as it may be passed on.

        Raises:
            ServiceRefused, GrantError: it may not.
        """
        return self._treat(self._request, "request", data, now)

    def response(self, data: Buffer, now: int) -> Pieces:
        """The response as it may be passed on.

        Raises:
            ServiceRefused, GrantError: it may not.
        """
        return self._treat(self._response, "response", data, now)

    def _treat(self, guard: Guard, what: str, data: Buffer, now: int) -> Pieces:
        pieces = guard(data, now)
        if pieces is None:
            raise ServiceRefused(
                f"the grant for {self._name} does not allow this {what}, or not now",
                "a condition or the rate in the grant forbids it: see `rossec grant show`",
            )
        return pieces
