"""The strip under a frame with the machine's numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

BACKGROUND, INK, DIM = (18, 18, 22), (235, 235, 235), (150, 150, 160)
SMALLEST, LARGEST = 10, 16
"""Sizes of the letters in pixels."""


def captioned(image: np.ndarray, cells: Sequence[tuple[str, str]]) -> np.ndarray:
    """The image with a strip below it of cells of equal width: a value, and under it what it is.

    Letters are as large as the narrowest cell allows, from SMALLEST to LARGEST pixels, and a picture that is too narrow for
    all cells in one row gets more rows. Width and height of the result are even, as film formats need.

    Args:
        image: (H, W, 3) uint8.
        cells: value and name of each cell.
    """
    height, width = image.shape[:2]
    rows, font = next(
        ((rows, font) for rows in range(1, len(cells) + 1) for font in _fonts() if _fits(cells, font, width, rows)),
        (len(cells), ImageFont.load_default(SMALLEST)))
    line = round(font.size * 1.35)
    high = rows * (2 * line + line // 2)
    picture = Image.new("RGB", (width + width % 2, height + high + (height + high) % 2), BACKGROUND)
    picture.paste(Image.fromarray(image))
    draw = ImageDraw.Draw(picture)
    columns = -(-len(cells) // rows)
    for number, (value, name) in enumerate(cells):
        row, column = divmod(number, columns)
        x, y = (column + 0.5) * width / columns, height + row * (2 * line + line // 2) + line // 4
        draw.text((x, y), value, font=font, fill=INK, anchor="ma")
        draw.text((x, y + line), name, font=font, fill=DIM, anchor="ma")
    return np.asarray(picture)


def _fonts() -> list[ImageFont.FreeTypeFont]:
    return [ImageFont.load_default(size) for size in range(LARGEST, SMALLEST - 1, -1)]


def _fits(cells: Sequence[tuple[str, str]], font: ImageFont.FreeTypeFont, width: int, rows: int) -> bool:
    columns = -(-len(cells) // rows)
    return all(font.getlength(text) + font.size <= width / columns for cell in cells for text in cell)
