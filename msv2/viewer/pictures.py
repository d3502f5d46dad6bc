"""What the viewer draws over a picture, how two eyes share one, and how a picture fits a window.

    levels          the frame tinted by each tile's level; a tile that blends two levels has the mean of their tints
    error           |golden - float| times the gain; black where they agree
    depth           near is yellow, far is violet, black where less than half of a pixel is covered
    intersections   how many intersections each tile has, on a logarithmic scale from black over red and yellow to white
    warp            of the second eye, where each pixel comes from: white a rendered tile, red a tile that was rendered because
                    of its holes, green a warped pixel, blue the source's background, yellow a filled hole

For two eyes, `depth` shows the source eye's depth and `warp` marks the other eye; the other half stays the plain picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.pipeline import Frame
from golden.scenes.gaze import FoveationMap
from golden.scenes.pictures import anaglyph, depth_picture, kinds_picture, levels_picture, to_bytes
from msv2.viewer.splat import Found
from msv2.viewer.state import ANAGLYPH, State
from spec.constants import TILE

_NEEDS_GOLDEN = ("error", "depth", "intersections", "warp")
_GAZE_COLOUR, _GAZE_EDGE = (255, 255, 255), (0, 0, 0)
_TILE_COLOUR, _PIXEL_COLOUR = (255, 255, 0), (0, 255, 255)
BARS = 24
"""Grey of the bars beside a picture that has another shape than its window."""


@dataclass(frozen=True)
class Eye:
    """One eye of a golden frame.

    Attributes:
        frame: the eye's own frame; of the second eye, with the rendered tiles only.
        image: (H, W, 3) float in 0..1.
        foveation: the eye's tile levels.
        depth: (H, W) float64, of the source eye only.
        kinds: (H, W) uint8, where the pixels of the second eye come from.
    """

    frame: Frame
    image: np.ndarray
    foveation: FoveationMap
    depth: np.ndarray | None = None
    kinds: np.ndarray | None = None

    @property
    def gaze(self) -> tuple[float, float] | None:
        """Where the eye looks."""
        return self.foveation.gaze_xy


def needs_golden(state: State) -> bool:
    """Whether the overlay needs the golden frame even if another renderer draws the picture."""
    return state.overlay in _NEEDS_GOLDEN


def eyes_of(golden: Frame | StereoFrame, foveation: FoveationMap) -> list[Eye]:
    """The eyes of a golden frame, left first; `foveation` is the source eye's."""
    if isinstance(golden, StereoFrame):
        images = [image / 255 for image in golden.images]
        source, target = golden.pair.left_right(*images)  # sorts both ways: it swaps or does not
        return list(golden.pair.left_right(
            Eye(golden.source, source, foveation, depth=golden.source.depth),
            Eye(golden.target, target, golden.foveation, kinds=golden.origin)))
    return [Eye(golden, golden.image, foveation, depth=golden.depth if golden.config.depth else None)]


def compose(
    state: State, images: Sequence[np.ndarray], eyes: Sequence[Eye] | None, floats: Sequence[np.ndarray] | None,
    foveations: Sequence[FoveationMap], found: Found | None,
) -> np.ndarray:
    """The picture of a state as uint8.

    Args:
        state: what is drawn.
        images: (H, W, 3) float images of the eyes, left first.
        eyes: the golden frame's eyes, where there is one.
        floats: the float renderer's images, where they were drawn.
        foveations: each eye's tile levels.
        found: a splat whose tiles are to be marked, in the first eye.
    """
    drawn = []
    for number, (image, foveation) in enumerate(zip(images, foveations, strict=True)):
        eye = eyes[number] if eyes else None
        picture = to_bytes(_overlaid(state, image, foveation, eye, floats[number] if floats else None))
        if state.marked and foveation.gaze_xy is not None:
            _mark_gaze(picture, foveation.gaze_xy)
        if found is not None and number == 0:
            _mark_splat(picture, found)
        drawn.append(picture)
    if len(drawn) == 1:
        return drawn[0]
    return anaglyph(*drawn) if state.eyes == ANAGLYPH else np.concatenate(drawn, axis=1)


def _overlaid(
    state: State, image: np.ndarray, foveation: FoveationMap, eye: Eye | None, exact: np.ndarray | None,
) -> np.ndarray:
    if state.overlay == "levels":
        return levels_picture(image, foveation)
    if eye is None:
        return image
    if state.overlay == "error" and exact is not None:
        return np.abs(np.clip(eye.image, 0, 1) - np.clip(exact, 0, 1)) * state.gain
    if state.overlay == "depth" and eye.depth is not None:
        return depth_picture(eye.depth)
    if state.overlay == "intersections":
        return intersections_picture(eye.frame)
    if state.overlay == "warp" and eye.kinds is not None:
        return kinds_picture(to_bytes(image), eye.kinds)
    return image


def intersections_picture(frame: Frame) -> np.ndarray:
    """(H, W, 3) float: intersections of each tile on a logarithmic scale, from black over red and yellow to white."""
    r = frame.registers
    counts = np.diff(frame.entries.start).reshape(r.tiles_y, r.tiles_x)
    heat = np.log1p(counts) / np.log1p(max(int(counts.max(initial=0)), 1))
    colour = np.clip(np.stack([3 * heat, 3 * heat - 1, 3 * heat - 2], axis=-1), 0, 1)
    return colour.repeat(TILE, axis=0).repeat(TILE, axis=1)[: r.height, : r.width]


def _line(picture: np.ndarray, x0: int, x1: int, y0: int, y1: int, colour: tuple[int, int, int]) -> None:
    """Fills columns x0..x1 and rows y0..y1, both inclusive, as far as they lie in the picture."""
    picture[max(y0, 0) : max(y1 + 1, 0), max(x0, 0) : max(x1 + 1, 0)] = colour


def _mark_gaze(picture: np.ndarray, gaze: tuple[float, float]) -> None:
    x, y = int(gaze[0]), int(gaze[1])
    arm = max(4, picture.shape[0] // 60)
    for width, colour in ((1, _GAZE_EDGE), (0, _GAZE_COLOUR)):
        _line(picture, x - arm, x + arm, y - width, y + width, colour)
        _line(picture, x - width, x + width, y - arm, y + arm, colour)


def _mark_splat(picture: np.ndarray, found: Found) -> None:
    for column, row in found.tiles:
        left, top = TILE * int(column), TILE * int(row)
        right, bottom = left + TILE - 1, top + TILE - 1
        for edges in ((left, right, top, top), (left, right, bottom, bottom), (left, left, top, bottom),
                      (right, right, top, bottom)):
            _line(picture, *edges, _TILE_COLOUR)
    x, y = found.pixel
    _line(picture, x - 3, x + 3, y, y, _PIXEL_COLOUR)
    _line(picture, x, x, y - 3, y + 3, _PIXEL_COLOUR)


def letterboxed(image: np.ndarray, aspect: float) -> np.ndarray:
    """The image with bars at two sides, so that its width over its height is `aspect`."""
    height, width = image.shape[:2]
    wide, high = max(width, round(height * aspect)), max(height, round(width / aspect))
    if width / height > aspect:
        wide = width
    else:
        high = height
    if (wide, high) == (width, height):
        return image
    framed = np.full((high, wide, 3), BARS, np.uint8)
    top, left = (high - height) // 2, (wide - width) // 2
    framed[top : top + height, left : left + width] = image
    return framed


def place_in_picture(place: tuple[float, float], aspect: float, width: int, height: int) -> tuple[float, float] | None:
    """The pixel of a picture of `width` by `height` at a place in a window; None on the bars.

    Args:
        place: x to the right and y down, both in 0..1 of the window.
        aspect: the window's width over its height.
    """
    share_x, share_y = min(1.0, width / height / aspect), min(1.0, aspect * height / width)
    x, y = ((at - (1 - share) / 2) / share for at, share in zip(place, (share_x, share_y), strict=True))
    return (x * width, y * height) if 0 <= x < 1 and 0 <= y < 1 else None
