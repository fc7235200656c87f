"""Who sees only the network: how long each record is, and no content, without any grant.

What a subscriber asks for is carried out as the product does (`rossec.participant.delivery_options`). The
observer has watched another day with the truth, and takes for each length the room it was most
often in. Beside it stands what lengths would tell if the publisher deflated what it filters.
"""

from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Final

from bench._flat import RATE, room_of, walk
from bench._views import by_preset, poses, received
from rossec.participant.delivery_options import DeliveryOptions, carried_out, deflated

_POSE: Final = "geometry_msgs/PoseStamped"
Lengths = list[tuple[int, int]]  # the length of each record, and the room


def observed(seeds: Sequence[int], seconds: int) -> dict[str, dict[str, float]]:
    """The share of messages of which the room is known: as sent, and if they were deflated."""
    restriction = by_preset("coarse-position", _POSE)
    decision: Any = SimpleNamespace(restrictions=(restriction,))
    taken = carried_out(DeliveryOptions(deflate=True), decision).deflate
    return {
        "as_sent": _scored(seeds, seconds, deflates=taken),
        "if_deflated": _scored(seeds, seconds, deflates=True),
    }


def _scored(seeds: Sequence[int], seconds: int, *, deflates: bool) -> dict[str, float]:
    learned: dict[int, Counter[int]] = {}
    rooms = Counter[int]()
    for length, room in _lengths(1, 4 * seconds, deflates=deflates):
        learned.setdefault(length, Counter())[room] += 1
        rooms[room] += 1
    usual = rooms.most_common(1)[0][0]
    found = [pair for seed in seeds for pair in _lengths(seed, seconds, deflates=deflates)]
    guessed = [learned[length].most_common(1)[0][0] if length in learned else usual for length, _ in found]
    right = sum(guess == room for guess, (_, room) in zip(guessed, found, strict=True))
    prior = sum(room == usual for _, room in found)
    count = len(found)
    return {
        "attacker": round(right / count, 3),
        "prior": round(prior / count, 3),
        "best": round(max(right, prior) / count, 3),
    }


def _lengths(seed: int, seconds: int, *, deflates: bool) -> Lengths:
    path = walk(seed, seconds)
    restriction = by_preset("coarse-position", _POSE)
    found: Lengths = []
    for at, message in received(_POSE, restriction, poses(path, RATE)):
        x, y = path[int(at * RATE)]
        length = len(deflated([message])) if deflates else len(message)
        found.append((length, int(room_of(x, y))))
    return found
