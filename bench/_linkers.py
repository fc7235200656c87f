"""Who wants to know which part in the messages of one receiver is which in those of another.

Two receivers of diagnostics put what they have side by side: pseudonyms, names, the order of the
array, and which levels change together.
"""

import struct
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bench._views import NOW, Publisher, by_preset, header, strings, text

Floats = npt.NDArray[np.float64]
Scores = dict[str, dict[str, float]]

PARTS: Final = 40
_DIAGNOSTICS: Final = "diagnostic_msgs/DiagnosticArray"
_FAULT: Final = 1 / 1200  # a second: how often a part has one, for two minutes on average
_REPAIR: Final = 1 / 120


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
    told: Sequence[Sequence[Sequence[tuple[int, bytes]]]], names: Sequence[Sequence[bytes]], *, ordered: bool
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
