"""A camera picture as a receiver gets it: small, as PNG in the page. Pure.

The last one is shown. An encoding that is not in the table is not drawn, and neither is one whose
bytes do not have the size that its header says.
"""

import base64
import io
from typing import Final

import numpy as np
from PIL import Image

from rossec.console.pictures.svg import Element, drawing
from rossec.console.samples import SeenTopic

TYPE: Final = "sensor_msgs/Image"
WIDTH: Final = 320.0
_MAX_SIDE: Final = 8192
_MAX_PNG: Final = 9_000  # bytes: a page has several, and at most 100 kB
_SIDES: Final = (240, 160, 120, 80, 40)
# Encoding of sensor_msgs/image_encodings: channels, and their order as red, green, blue.
_ENCODINGS: Final = {
    "mono8": (1, None), "8UC1": (1, None), "rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
}  # fmt: skip


def draw(seen: SeenTopic) -> Element | None:
    """The last picture; None if there is none, or it cannot be read."""
    found = _picture(seen)
    if found is None:
        return None
    height = WIDTH * found.height / found.width
    shown = Element.picture(
        base64.b64encode(_png(found)).decode(), width=WIDTH, height=height, class_="photo"
    )
    return drawing(WIDTH, height, f"The picture that {seen.receiver} sees", shown, class_="camera")


def _picture(seen: SeenTopic) -> Image.Image | None:
    if not seen.samples:
        return None
    fields = seen.samples[-1].fields
    height, width, row = int(fields["height"]), int(fields["width"]), int(fields["step"])
    channels, order = _ENCODINGS.get(str(fields["encoding"]), (0, None))
    data = np.asarray(fields["data"], dtype=np.uint8)
    fits = 0 < width <= _MAX_SIDE and 0 < height <= 4 * width and row >= width * channels > 0
    if not fits or data.size != height * row:
        return None
    pixels = data.reshape(height, row)[:, : width * channels]
    if order is None:
        return Image.fromarray(pixels.copy())
    return Image.fromarray(pixels.reshape(height, width, channels)[:, :, list(order)].copy())


def _png(picture: Image.Image) -> bytes:
    """The PNG of at most `_MAX_PNG` bytes, as large as it can be."""
    data = b""
    for side in _SIDES:
        small = picture.copy()
        small.thumbnail((side, side), Image.Resampling.BOX)
        out = io.BytesIO()
        small.save(out, "PNG", optimize=True)
        data = out.getvalue()
        if len(data) <= _MAX_PNG:
            break
    return data
