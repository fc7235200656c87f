"""Who wants to know which is which: a part in the messages of two receivers, a face in a gallery.

Two receivers of diagnostics put what they have side by side: pseudonyms, names, the order of the
array, and which levels change together. A gallery holds the faces without a filter; the watcher
knows the room, the place of the face and the filter, and compares what it is sent with what each
face would have given.
"""

import struct
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bench._views import NOW, Publisher, by_preset, header, layout, strings, text
from grants.filters.compile import compile_filter

Floats = npt.NDArray[np.float64]
Scores = dict[str, dict[str, float]]

PARTS: Final = 16
_DIAGNOSTICS: Final = "diagnostic_msgs/DiagnosticArray"
_FAULT: Final = 1 / 1200  # a second: how often a part has one, for two minutes on average
_REPAIR: Final = 1 / 120
_IMAGE: Final = "sensor_msgs/Image"
WIDE, HIGH, FACE = 160, 128, 64
_NOISE: Final = 4.0
_MOVED: Final = 10  # pictures of somebody who moves


def linked_parts(minutes: Sequence[int]) -> Scores:
    """The share of parts that two receivers find to be the same, after so many minutes."""
    found = {each: _linked(each) for each in minutes}
    longest = max(minutes)
    more = {f"linkage_accuracy_{each}_min": found[each] for each in minutes if each != longest}
    return {"linkage_accuracy": found[longest], **more}


def _linked(minutes: int) -> dict[str, float]:
    restriction = by_preset("anonymous-diagnostics", _DIAGNOSTICS)
    publisher = Publisher(_DIAGNOSTICS)
    guards = [publisher.guard(restriction, receiver) for receiver in (1, 2)]
    told: list[list[list[tuple[int, bytes]]]] = [[], []]
    for second, message in enumerate(_diagnostics(60 * minutes)):
        for guard, kept in zip(guards, told, strict=True):
            pieces = guard.apply(message, NOW + second)
            if pieces is not None:
                kept.append(_parts(b"".join(pieces)))
    owners = [_owners(guard.apply) for guard in _fresh(restriction)]
    names = [sorted({label for parts in kept for _, label in parts}) for kept in told]
    same = np.array([[float(a == b) for b in names[1]] for a in names[0]])
    levels = _agreement(told, names, ordered=False)
    order = _agreement(told, names, ordered=True)
    truth = np.array([[owners[0].get(a) == owners[1].get(b) for b in names[1]] for a in names[0]])
    best = max(_right(same * 1e9 + each, truth) for each in (levels, levels + order))
    return {"naive": _right(same, truth), "prior": round(1 / PARTS, 3), "attacker": best}


def _fresh(restriction: Any) -> list[Any]:
    publisher = Publisher(_DIAGNOSTICS)
    return [publisher.guard(restriction, receiver) for receiver in (1, 2)]


def _owners(apply: Any) -> dict[bytes, int]:
    """Which part has which label; a message of one part each tells, to whoever counts the score."""
    found: dict[bytes, int] = {}
    for part in range(PARTS):
        pieces = apply(_message(0, [(0, part)]), NOW + 1000 * part)
        found[_parts(b"".join(pieces))[0][1]] = part
    return found


def _diagnostics(seconds: int) -> Iterator[bytes]:
    rng = np.random.default_rng(5)
    broken = np.zeros(PARTS, bool)
    for second in range(seconds):
        chance = rng.random(PARTS)
        broken = np.where(broken, chance > _REPAIR, chance < _FAULT)
        yield _message(second, [(2 * int(broken[part]), part) for part in range(PARTS)])


def _message(second: int, parts: Sequence[tuple[int, int]]) -> bytes:
    found = [header(second, second), struct.pack("<I", len(parts))]
    for level, part in parts:
        label = b"part %d" % part
        found += [bytes([level]), text(b"name of " + label), text(b"ok"), text(label), bytes(4)]
    return b"".join(found)


def _parts(message: bytes) -> list[tuple[int, bytes]]:
    """Level and label of each part: its name and its number, as they are said."""
    _, at = strings(message, 12, 1)
    count = int.from_bytes(message[at : at + 4], "little")
    at += 4
    found = []
    for _ in range(count):
        level = message[at]
        (name, _, identity), at = strings(message, at + 1, 3)
        at += 4  # values are dropped
        found.append((level, name + b"/" + identity))
    return found


def _agreement(
    told: Sequence[Sequence[Sequence[tuple[int, bytes]]]],
    names: Sequence[Sequence[bytes]],
    *,
    ordered: bool,
) -> Floats:
    """How often two labels had the same level, or the same place in the array."""
    series = []
    for kept, labels in zip(told, names, strict=True):
        rows = np.zeros((len(labels), len(kept)))
        for column, parts in enumerate(kept):
            for place, (level, label) in enumerate(parts):
                rows[labels.index(label), column] = place if ordered else level
        series.append(rows)
    return np.array([[float((a == b).sum()) for b in series[1]] for a in series[0]])


def _right(scores: Floats, truth: npt.NDArray[np.bool_]) -> float:
    """The share of rows whose highest score is the true one; of equal ones, one is guessed."""
    highest = scores == scores.max(axis=1, keepdims=True)
    return round(float(((highest & truth).sum(axis=1) / highest.sum(axis=1)).mean()), 3)


def faces(count: int, tried: int) -> Scores:
    """The share of faces found in a gallery, by one picture and by ten of a face that moves."""
    gallery = _gallery(count)
    rng = np.random.default_rng(6)
    room = _smooth(rng, (HIGH, WIDE), 12) * 30 + 120
    found = {"naive": 0.0, "attacker": 0.0, "moved": 0.0}
    for number in range(tried):
        who = number % count
        places = [tuple(rng.integers(0, (WIDE - FACE, HIGH - FACE))) for _ in range(_MOVED)]
        told = [_seen(_picture(room, gallery[who], place, rng)) for place in places]
        off = np.array(
            [_distances(one, room, gallery, at) for one, at in zip(told, places, strict=True)]
        )
        found["naive"] += _guessed(_naive(told[0], gallery, places[0]), who)
        found["attacker"] += _guessed(off[0], who)
        found["moved"] += _guessed(off.sum(axis=0), who)
    share = {name: round(right / tried, 3) for name, right in found.items()}
    prior = round(1 / count, 3)
    return {
        "linkage_accuracy": {
            "naive": share["naive"], "prior": prior, "attacker": share["attacker"],
        },
        "linkage_accuracy_10_pictures": {
            "naive": share["naive"], "prior": prior, "attacker": share["moved"],
        },
    }  # fmt: skip


def _smooth(rng: np.random.Generator, shape: tuple[int, int], width: int) -> Floats:
    """Noise without detail finer than `width`, of deviation 1."""
    noise = rng.normal(size=shape)
    kernel = np.exp(-0.5 * (np.arange(-2 * width, 2 * width + 1) / width) ** 2)
    for axis in (0, 1):
        noise = np.apply_along_axis(lambda line: np.convolve(line, kernel, "same"), axis, noise)
    return np.asarray(noise / noise.std())


def _gallery(count: int) -> Floats:
    """Faces have most in common; one differs from another in features of some pixels."""
    rng = np.random.default_rng(7)
    common = 130 + 25 * _smooth(rng, (FACE, FACE), 8)
    own = [12 * _smooth(rng, (FACE, FACE), 4) for _ in range(count)]
    return np.array([common + (each - each.mean()) for each in own])


def _picture(room: Floats, face: Floats, place: Any, rng: np.random.Generator | None) -> Floats:
    x, y = place
    found = room.copy()
    found[y : y + FACE, x : x + FACE] = face
    if rng is not None:
        found = found * rng.uniform(0.9, 1.1) + rng.normal(0, _NOISE, found.shape)
    return np.clip(found, 0, 255)


def _serialized(picture: Floats) -> bytes:
    head = header(0, 0) + struct.pack("<II", HIGH, WIDE) + text(b"mono8")
    return head + struct.pack("<BII", 0, WIDE, HIGH * WIDE) + picture.astype(np.uint8).tobytes()


_FILTER: Final = compile_filter(layout(_IMAGE), by_preset("blurred-camera", _IMAGE).filters)


def _seen(picture: Floats) -> Floats:
    sent = b"".join(_FILTER(_serialized(picture)))
    return np.frombuffer(sent[-HIGH * WIDE :], np.uint8).reshape(HIGH, WIDE).astype(float)


def _distances(told: Floats, room: Floats, gallery: Floats, place: Any) -> Floats:
    """How far each face's own picture is, in the best light of three."""
    x, y = place
    part = (slice(y, y + FACE), slice(x, x + FACE))
    found = np.full(len(gallery), np.inf)
    for light in (0.93, 1.0, 1.07):
        made = [
            _seen(np.clip(_picture(room, face, place, None) * light, 0, 255)) for face in gallery
        ]
        off = np.array([np.abs(told[part] - each[part]).mean() for each in made])
        found = np.minimum(found, off)
    return found


def _naive(told: Floats, gallery: Floats, place: Any) -> Floats:
    x, y = place
    return np.array([np.abs(told[y : y + FACE, x : x + FACE] - face).mean() for face in gallery])


def _guessed(off: Floats, who: int) -> float:
    nearest = off == off.min()
    return float(nearest[who]) / float(nearest.sum())
