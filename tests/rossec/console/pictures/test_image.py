"""Camera pictures, as their receivers get them."""

import base64
import io
import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

from grants.model import Restriction, filter_rules
from rossec.console import samples
from rossec.console.pictures import looks
from rossec.console.pictures.svg import SvgElement
from rossec.console.samples import SeenTopic, SyntheticSample, see
from tests.support.drawings import checked


def picture(**fields: Any) -> SeenTopic:
    given = {"height": 2, "width": 2, "step": 2, "encoding": "mono8", "data": np.zeros(4, np.uint8)}
    return SeenTopic("/a", "/c", looks.IMAGE_TYPE, 1, (SyntheticSample(0, given | fields),))


def decoded(drawn: SvgElement | None) -> Image.Image:
    checked(drawn)
    found = re.search(r"base64,([A-Za-z0-9+/=]+)", str(drawn))
    assert found is not None
    return Image.open(io.BytesIO(base64.b64decode(found[1])))


def test_a_blurred_picture_is_blurred_in_the_page() -> None:
    recorded = samples.recorded("/camera", looks.IMAGE_TYPE)
    assert recorded is not None
    blur = Restriction(looks.IMAGE_TYPE, (), filter_rules({"data": {"pixelate": {"block": 40}}}))
    exact = decoded(looks.draw_image(see(recorded, "/doctor", ())))
    coarse = decoded(looks.draw_image(see(recorded, "/heating", (blur,))))
    assert exact.size == coarse.size
    colours = [len(each.convert("RGB").getcolors(1 << 20) or ()) for each in (exact, coarse)]
    assert colours[1] <= 12
    assert len({coarse.convert("RGB").getpixel((x, 0)) for x in range(coarse.width)}) <= 4


@pytest.mark.parametrize(
    ("encoding", "pixel", "shown"),
    [
        ("rgb8", (1, 2, 3), (1, 2, 3)),
        ("bgr8", (1, 2, 3), (3, 2, 1)),
        ("rgba8", (1, 2, 3, 9), (1, 2, 3)),
        ("bgra8", (1, 2, 3, 9), (3, 2, 1)),
    ],
)
def test_the_channels_are_those_of_the_encoding(
    encoding: str, pixel: tuple[int, ...], shown: tuple[int, ...]
) -> None:
    data = np.tile(np.array(pixel, np.uint8), 4)
    made = picture(encoding=encoding, step=2 * len(pixel), data=data)
    assert decoded(looks.draw_image(made)).getpixel((1, 1)) == shown


@pytest.mark.parametrize(
    "fields",
    [
        {"encoding": "bayer_rggb8"},
        {"width": 0},
        {"width": 3},
        {"height": 1 << 20},
        {"data": np.zeros(5, np.uint8)},
        {"step": 1},
    ],
    ids=["encoding", "no-width", "row", "tall", "size", "step"],
)
def test_a_picture_that_cannot_be_read_is_not_drawn(fields: dict[str, Any]) -> None:
    assert looks.draw_image(picture(**fields)) is None
    assert looks.draw_image(picture()._replace(samples=())) is None


def test_noise_is_made_small_enough_for_a_page() -> None:
    noise = np.frombuffer(np.random.default_rng(1).bytes(640 * 480), np.uint8)
    drawn = looks.draw_image(picture(width=640, height=480, step=640, data=noise))
    assert len(str(drawn)) < 14_000
