"""Who wants to know whose face is in a picture, and has a gallery of fifty without a filter.

The watcher knows the room, the place of the face and the filter, and compares what it is sent with
what each face would have given there, in the best light of three; of somebody who moves it adds up
the pictures. The filter is whatever the preset says, on a picture of 640 by 480.
"""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from bench._views import by_preset, header, layout, text
from grants.filters.compile import compile_filter

Floats = npt.NDArray[np.float64]
Scores = dict[str, dict[str, float]]

COUNT: Final = 50
WIDE, HIGH = 640, 480
_IMAGE: Final = "sensor_msgs/Image"
_NOISE: Final = 4.0
_LIGHTS: Final = (0.93, 1.0, 1.07)
_FILTER: Final = compile_filter(layout(_IMAGE), by_preset("blurred-camera", _IMAGE).filters)
Place = tuple[int, int]


def faces(size: int, tried: int, pictures: Sequence[int], count: int = COUNT) -> Scores:
    """The share of faces of `size` pixels found in the gallery, by so many pictures of each."""
    gallery = _gallery(count, size)
    rng = np.random.default_rng(6)
    room = _smooth(rng, (HIGH, WIDE), 12) * 30 + 120
    places = [
        (int(rng.integers(0, WIDE - size)), int(rng.integers(0, HIGH - size))) for _ in range(max(pictures))
    ]
    expected = [
        np.array([[_part(_lit(room, face, at, light), at, size) for light in _LIGHTS] for face in gallery])
        for at in places
    ]
    found = {(name, number): 0.0 for name in ("naive", "attacker") for number in pictures}
    for number in range(tried):
        who = number % count
        off, plain = np.zeros(count), np.zeros(count)
        for shown, (at, made) in enumerate(zip(places, expected, strict=True), 1):
            told = _part(_noisy(room, gallery[who], at, rng), at, size)
            off += np.abs(made - told).mean(axis=(2, 3)).min(axis=1)
            plain += np.abs(gallery - told).mean(axis=(1, 2))
            if shown in pictures:
                found["attacker", shown] += _guessed(off, who)
                found["naive", shown] += _guessed(plain, who)
    prior = round(1 / count, 3)
    return {f"{each}_pictures": _scores(found, each, tried, prior) for each in pictures}


def _scores(found: dict[tuple[str, int], float], pictures: int, tried: int, prior: float) -> dict[str, float]:
    shares = {name: round(found[name, pictures] / tried, 3) for name in ("naive", "attacker")}
    return {**shares, "prior": prior, "best": max(*shares.values(), prior)}


def _smooth(rng: np.random.Generator, shape: tuple[int, int], width: int) -> Floats:
    """Noise without detail finer than `width`, of deviation 1."""
    noise = rng.normal(size=shape)
    kernel = np.exp(-0.5 * (np.arange(-2 * width, 2 * width + 1) / width) ** 2)
    for axis in (0, 1):
        noise = np.apply_along_axis(lambda line: np.convolve(line, kernel, "same"), axis, noise)
    return np.asarray(noise / noise.std())


def _gallery(count: int, size: int) -> Floats:
    """Faces have most in common; features of a sixteenth of a face tell one from another."""
    rng = np.random.default_rng(7)
    common = 130 + 25 * _smooth(rng, (size, size), size // 8)
    own = [12 * _smooth(rng, (size, size), size // 16) for _ in range(count)]
    return np.array([common + (each - each.mean()) for each in own])


def _put(room: Floats, face: Floats, place: Place) -> Floats:
    x, y = place
    found = room.copy()
    found[y : y + len(face), x : x + len(face)] = face
    return found


def _lit(room: Floats, face: Floats, place: Place, light: float) -> Floats:
    return np.clip(_put(room, face, place) * light, 0, 255)


def _noisy(room: Floats, face: Floats, place: Place, rng: np.random.Generator) -> Floats:
    found = _put(room, face, place)
    return np.clip(found * rng.uniform(0.9, 1.1) + rng.normal(0, _NOISE, found.shape), 0, 255)


def _part(picture: Floats, place: Place, size: int) -> Floats:
    """Where the face is, as it is sent."""
    x, y = place
    head = header(0, 0) + struct.pack("<II", HIGH, WIDE) + text(b"mono8")
    data = struct.pack("<BII", 0, WIDE, HIGH * WIDE) + picture.astype(np.uint8).tobytes()
    sent = b"".join(_FILTER(head + data))
    seen = np.frombuffer(sent[-HIGH * WIDE :], np.uint8).reshape(HIGH, WIDE)
    return seen[y : y + size, x : x + size].astype(float)


def _guessed(off: Floats, who: int) -> float:
    nearest = off == off.min()
    return float(nearest[who]) / float(nearest.sum())
