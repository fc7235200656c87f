"""A picture of a terminal: characters in cells, colours from the escape codes."""

import re
from typing import Final

from PIL import Image, ImageDraw, ImageFont

CELL: Final = (10, 20)  # pixels of a character, as terminals have them
_FONT: Final = "/usr/share/fonts/truetype/dejavu/DejaVuSansMono.ttf"
_THEMES: Final = {True: ((0, 0, 0), (220, 220, 220)), False: ((255, 255, 255), (30, 30, 30))}
_PALETTE: Final = {16: (0, 0, 0), 231: (255, 255, 255)}  # those used of the 256 colours
# Which of the upper and the lower half of a cell is ink.
_BLOCKS: Final = {"\u2580": (True, False), "\u2584": (False, True), "\u2588": (True, True)}
Colour = tuple[int, int, int]


def picture(text: str, *, dark: bool) -> Image.Image:
    """A screenshot of `text` on a terminal with a dark or a light theme."""
    lines = text.splitlines()
    width = max(len(re.sub("\x1b\\[[0-9;]*[mK]", "", line)) for line in lines)
    page, ink = _THEMES[dark]
    image = Image.new("RGB", ((width + 4) * CELL[0], (len(lines) + 2) * CELL[1]), page)
    for row, line in enumerate(lines, 1):
        _draw(ImageDraw.Draw(image), row, line, page, ink)
    return image


def _draw(draw: ImageDraw.ImageDraw, row: int, line: str, page: Colour, ink: Colour) -> None:
    font = ImageFont.truetype(_FONT, 16)
    column, front, back = 2, ink, page
    for part in re.findall("\x1b\\[[0-9;]*[mK]|.", line):
        if part.startswith("\x1b"):
            front, back = _colours(part, (front, back), (ink, page))
            continue
        left, top = column * CELL[0], row * CELL[1]
        middle, right, bottom = top + CELL[1] // 2, left + CELL[0] - 1, top + CELL[1] - 1
        draw.rectangle((left, top, right, bottom), back)
        if part in _BLOCKS:
            upper, lower = _BLOCKS[part]
            draw.rectangle((left, top, right, middle - 1), front if upper else back)
            draw.rectangle((left, middle, right, bottom), front if lower else back)
        else:
            draw.text((left, top), part, front, font)
        column += 1


def _colours(code: str, now: tuple[Colour, Colour], theme: tuple[Colour, Colour]) -> tuple[Colour, Colour]:
    numbers = [int(number) for number in re.findall("[0-9]+", code)]
    front, back = now
    if numbers == [0]:
        return theme
    for place in range(0, len(numbers), 3):
        where, _, colour = numbers[place : place + 3]
        front = _PALETTE[colour] if where == 38 else front
        back = _PALETTE[colour] if where == 48 else back
    return front, back
