"""What fails while messages flow between sites: a router that dies, a grant that is revoked.

Not in the thesis. The list of revocations is given to the master of the third site; it has to come
to the others through the overlay, so the time is that of the whole system: from the moment the
list is given until the last message that the receiver was sent. A gateway's grant is revoked at
the origin; what counts is the last message that any node behind the gateway was sent.
"""

import signal
import time
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

from bench.thesis.gateways import Gatewayed
from bench.thesis.setups import LISTENERS, Relayed, Setup
from bench.thesis.talk import Point
from grants.document import grant_id

_FLOW: Final = Point(100, 100, 400)
_BEFORE: Final = 1.0  # seconds of flow before something fails
_NUMBERS: Final = (90_001, 90_002)  # of the points


def longest_gap(arrived: Mapping[int, float]) -> float:
    """The longest time without a message, in seconds."""
    times = sorted(arrived.values())
    return max((after - before for before, after in pairwise(times)), default=0.0)


def measure(made: Setup) -> dict[str, Any]:
    """What fails in a set-up, which is of no use afterwards."""
    if isinstance(made, Gatewayed):
        return gateway_revocation(made)
    return {**revocation(made), **router_death(made)} if isinstance(made, Relayed) else {}


def revocation(made: Relayed) -> dict[str, Any]:
    """Milliseconds from the list at `s3` to the last message of a receiver at `s2`."""
    grant = made.grants[LISTENERS[0]]
    _begin(made, _NUMBERS[0])
    at = time.monotonic()
    made.listeners[-1].ask(deliver="rossec.updateRevocations", list=made.site.revoke(grant).hex())
    found = _arrivals(made, _NUMBERS[0])
    last, other = (max(each.values(), default=0.0) for each in found[:2])
    if last >= other - 1:  # it received to the end, as the one beside it
        raise RuntimeError(f"the grant {grant_id(grant).hex()} is revoked, and still used")
    return {"revocation_ms": round((last - at) * 1000, 1)}


def gateway_revocation(made: Gatewayed) -> dict[str, Any]:
    """Milliseconds from the list at the origin to the last message behind the gateway of `s2`."""
    _begin(made, _NUMBERS[0])
    at = time.monotonic()
    revoked = made.site.revoke(made.grants["s2"])
    made.clerk.ask(deliver="rossec.updateRevocations", list=revoked.hex())
    found = [max(each.values(), default=0.0) for each in _arrivals(made, _NUMBERS[0])]
    behind, others = max(found[:3]), max(found[3:])
    if behind >= others - 1:
        raise RuntimeError("the grant of the gateway of s2 is revoked, and still used")
    return {"gateway_revocation_ms": round((behind - at) * 1000, 1)}


def router_death(made: Relayed) -> dict[str, Any]:
    """Kill the router in use; the longest silence at a site, and what was lost."""
    _begin(made, _NUMBERS[1])
    used = made.router_of["s2"]
    next(program for end, program in made.routers.items() if used.endswith(end)).signal(signal.SIGKILL)
    found = _arrivals(made, _NUMBERS[1])[1:3]  # both are at s2, and may receive
    return {
        "router_gap_ms": round(max(map(longest_gap, found)) * 1000, 1),
        "router_lost_messages": sum(_FLOW.count - len(each) for each in found),
    }


def _begin(made: Setup, number: int) -> None:
    order = {"size": _FLOW.size, "rate": _FLOW.rate, "count": _FLOW.count}
    made.talker.tell(number=number, point=order)
    time.sleep(_BEFORE)


def _arrivals(made: Setup, number: int) -> list[dict[int, float]]:
    """When each message of the flow arrived at each receiver, once it has ended."""
    made.talker.answer(_FLOW.seconds + 30)
    time.sleep(1)
    answers = [each.ask(number=number, last=True) for each in made.listeners]
    return [{int(n): at for n, at in each.items()} for each in answers]
