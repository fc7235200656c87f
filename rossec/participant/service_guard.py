"""What a decision means for the two messages of a call: one guard for each.

Pure. A restriction for the response type (`std_srvs/TriggerResponse`) applies to responses; every
other one applies to requests, so that a rate or a time counts once per call. A restriction for any
other type refuses the connection. Both ends use this: the server with the client's right to call,
the client with the server's right to provide.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from ca.domains.aliases import shown
from grants.decision import Decision
from grants.filters.codegen import Buffer
from grants.guard import Guard, needed_keys
from grants.memory import MemoryScope
from rossec.errors import ServiceRefused
from rossec.participant.service_types import ServiceType

Pieces = Sequence[Buffer]


class ServiceGuard:
    """Filters the requests and responses of one connection.

    Args:
        filter_key: finds a key for pseudonyms by its name.
        memory: finds what earlier connections of the same key have used up.

    Raises:
        GrantError: a restriction is for another type.
        ConfigurationError: a key for pseudonyms cannot be read.
    """

    def __init__(
        self,
        kind: ServiceType,
        decision: Decision,
        filter_key: Callable[[str], bytes],
        memory: MemoryScope,
    ) -> None:
        keys = {name: filter_key(name) for name in needed_keys(decision.restrictions)}
        restrictions = decision.restrictions
        on_response = tuple(item for item in restrictions if item.type == kind.response.name)
        on_request = tuple(item for item in restrictions if item.type != kind.response.name)
        self._name = shown(decision.name)
        request, response = (
            replace(decision, restrictions=some) for some in (on_request, on_response)
        )
        self._request = Guard(kind.request_layout, request, keys, memory)
        self._response = Guard(kind.response_layout, response, keys, memory.child("response"))

    def request(self, data: Buffer, now: float) -> Pieces:
        """The request as it may be forwarded.

        Raises:
            ServiceRefused, GrantError: it may not be.
        """
        return self._filter(self._request, "request", data, now)

    def response(self, data: Buffer, now: float) -> Pieces:
        """The response as it may be forwarded.

        Raises:
            ServiceRefused, GrantError: it may not be.
        """
        return self._filter(self._response, "response", data, now)

    def _filter(self, guard: Guard, what: str, data: Buffer, now: float) -> Pieces:
        pieces = guard(data, now)
        if pieces is None:
            raise ServiceRefused(
                f"the grant for {self._name} does not allow this {what}, or not now",
                "a condition or the rate in the grant forbids it: see `rossec grant show`",
            )
        return pieces
