"""Who follows a car by its coarse place on the earth, a robot by its wheels, or its first message.

A car turns at crossings and drives 8 m/s. A cell is left at a border, and the arrival tells when,
to one slot: the attacker puts the car at the border then, and on the line between two borders.
"""

import struct
from itertools import pairwise
from typing import Final

import numpy as np

from bench._trackers import Floats
from bench._views import NOW, Publisher, by_preset, header, layout, poses, received, text
from bench._watchers import day, first_messages
from grants.filters.layout import Layout
from grants.model import Restriction
from grants.vocabulary.contents import DataWord, describe
from grants.vocabulary.levels import resolve

_FIX: Final = "sensor_msgs/NavSatFix"
_JOINTS: Final = "sensor_msgs/JointState"
_POSE: Final = "geometry_msgs/PoseStamped"
_METRES: Final = 111_320
_SPEED: Final = 8.0
_AREA: Final = 20_000.0  # metres, of a town
_RADIUS: Final = 0.1  # metres, of a wheel
_PLACE: Final = struct.Struct("<3d")


def driven(level: str, seeds: range, hours: int) -> dict[str, float]:
    """The median error in metres on one axis: of a car, and where a cell is left."""
    found: list[list[float]] = [[], [], [], []]
    for seed in seeds:
        way = _drive(seed, hours * 3600)
        told = _told(_seen(level), way)
        for kept, errors in zip(found, _errors(told, way), strict=True):
            kept.extend(errors)
    naive, attacker, crossing, prior = (
        round(float(np.median(each)), 1) if each else float("inf") for each in found
    )
    best = min(naive, attacker, prior)
    return {
        "naive": naive,
        "prior": prior,
        "attacker": attacker,
        "best": best,
        "where_a_cell_is_left": crossing,
    }


def _seen(level: str) -> Restriction:
    shape: Layout = layout(_FIX)
    resolved = resolve(shape, describe(shape), {DataWord.POSITION: level})
    return Restriction(_FIX, (), resolved.rules, resolved.rate, slot=resolved.slot)


def _drive(seed: int, seconds: int) -> Floats:
    """Metres north of somewhere, each second: streets of 200 to 2,000 m, half of them north."""
    rng = np.random.default_rng(seed)
    steps: list[Floats] = []
    at = float(rng.uniform(0, _AREA))
    while sum(map(len, steps)) < seconds:
        ahead = float(rng.uniform(200, 2000)) * float(rng.choice((-1, 0, 1)))
        end = float(np.clip(at + ahead, 0, _AREA))
        count = max(25, int(abs(end - at) / _SPEED))
        steps.append(at + (end - at) * np.arange(count) / count)
        at = end
    return np.concatenate(steps)[:seconds]


def _told(restriction: Restriction, way: Floats) -> list[tuple[int, float]]:
    messages = (
        (
            float(second),
            header(second, second) + bytes(3) + _PLACE.pack(48 + metres / _METRES, 11.0, 500.0) + bytes(73),
        )
        for second, metres in enumerate(way.tolist())
    )
    return [
        (int(at), (_PLACE.unpack_from(message, len(message) - 73 - _PLACE.size)[0] - 48) * _METRES)
        for at, message in received(_FIX, restriction, messages)
    ]


def _errors(told: list[tuple[int, float]], way: Floats) -> tuple[list[float], ...]:
    if not told:
        return [], [], [], list(map(float, np.abs(way - _AREA / 2)))
    seconds = np.arange(told[0][0], len(way))
    times, places = np.array([at for at, _ in told]), np.array([place for _, place in told])
    held = places[np.searchsorted(times, seconds, "right") - 1]
    marks, crossing = [], []
    for (before, left), (at, entered) in pairwise(told):
        if left != entered:
            # With hysteresis of half a step a cell is left one step from its middle.
            border = left + (entered - left) / abs(entered - left) * min(abs(entered - left), 0.02 * _METRES)
            middle = (before + at) // 2
            marks.append((middle, border))
            crossing.append(float(abs(way[middle] - border)))
    line = held
    if marks:
        line = np.interp(seconds, [at for at, _ in marks], [place for _, place in marks])
    truth = way[seconds[0] :]
    return (list(np.abs(held - truth)), list(np.abs(line - truth)), crossing, list(np.abs(truth - _AREA / 2)))


def wheels(seconds: int) -> dict[str, float]:
    """The error in metres of the way that was gone, by the joint of a wheel."""
    restriction = by_preset("coarse-position", _JOINTS)
    rng = np.random.default_rng(8)
    way = np.cumsum(rng.uniform(0, 0.1, seconds * 10))
    guard = Publisher(_JOINTS).guard(restriction)
    gone, prior = [], []
    last = 0.0
    for number, metres in enumerate(way.tolist()):
        at = number / 10
        message = (
            header(number, at)
            + struct.pack("<I", 1)
            + text(b"wheel")
            + struct.pack("<Id", 1, metres / _RADIUS)
            + bytes(8)
        )
        pieces = guard.apply(message, NOW + at)
        if pieces is not None:
            sent = b"".join(pieces)
            (count,) = struct.unpack_from("<I", sent, len(header(0, 0)) + 13)
            if count:
                last = struct.unpack_from("<d", sent, len(header(0, 0)) + 17)[0] * _RADIUS
        gone.append(abs(last - metres))
        prior.append(abs(0.05 * number - metres))
    found = {"naive": float(np.median(gone)), "prior": float(np.median(prior))}
    return {name: round(value, 2) for name, value in found.items()} | {"best": round(min(found.values()), 2)}


def movements(seconds: int) -> dict[str, float]:
    """A publisher that sends while it moves: the share of starts known to 5 s, and the error."""
    restriction = by_preset("coarse-position", _POSE)
    spans = day(9, seconds)
    path = np.zeros((seconds * 10, 2))
    moving = np.zeros(len(path), bool)
    for start, end in spans:
        moving[int(start * 10) : int(end * 10) + 1] = True
    sent = (pair for pair, moves in zip(poses(path, 10), moving, strict=True) if moves)
    told = np.array([at for at, _ in received(_POSE, restriction, sent)])
    firsts = np.array(first_messages(told))
    starts = np.array([start for start, end in spans if end - start >= 60])
    if not len(firsts):
        return {"starts_told": 0.0, "error_s": float("inf")}
    off = np.array([np.abs(firsts - start).min() for start in starts])
    late = float(np.median(off))
    off = np.array([np.abs(firsts - late - start).min() for start in starts])
    return {
        "starts_told": round(float((off <= 5).mean()), 3),
        "by_chance": round(len(firsts) * 10 / seconds, 3),
        "error_s": round(float(np.median(off)), 1),
    }
