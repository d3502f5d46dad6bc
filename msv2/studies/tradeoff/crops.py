"""Crops of the pictures that one pays for: the same part of a frame with settings of different cost."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from golden.msv2_ref import pipeline
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.load import EMBEDDED
from golden.scenes.pictures import to_bytes
from msv2.studies.tradeoff.frontiers import CLOCK_GHZ, named_rows
from msv2.studies.tradeoff.knobs import DEFAULT, Setting, base_of, combined, single
from msv2.studies.tradeoff.scene import SceneRequest, TradeoffScene, load
from msv2.studies.tradeoff.tables import Content
from spec.config import AcceleratorConfig

SIZE, WINDOW = "640x360", (184, 138)
"""Sizes in pixels of the rendered frame, and of the part of it that is shown."""

MOST = 6
QUALITY = 92
COLUMNS = 3
ORIGINALS = {True: "the ray-traced original", False: "the photograph"}
"""What the first crop of a row is called, by whether the scene is the embedded one."""


@dataclass(frozen=True)
class Crop:
    """A part of a frame as (H, W, 3) uint8, with a caption that says what it costs."""

    pixels: np.ndarray
    caption: str

    def jpeg(self) -> bytes:
        """The part as a JPEG."""
        file = io.BytesIO()
        Image.fromarray(self.pixels).save(file, format="JPEG", quality=QUALITY)
        return file.getvalue()


def largest_difference(one: np.ndarray, other: np.ndarray, window: tuple[int, int] = WINDOW) -> tuple[int, int]:
    """(x, y) of the window in which two images (H, W, 3) differ most, by the sum of squares."""
    width, height = (min(size, limit) for size, limit in zip(window, one.shape[1::-1], strict=True))
    squares = ((one - other) ** 2).sum(axis=2)
    sums = np.pad(squares.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    y, x = np.unravel_index(int(inside.argmax()), inside.shape)
    return int(x), int(y)


def setting_of(row: dict, scene: TradeoffScene, base: AcceleratorConfig) -> Setting:
    """The setting of the machine `base` that a row of the content names."""
    degree = scene.leveled[""].sh_degree
    if row["parts"]:
        return combined(row["value"], [tuple(part) for part in row["parts"]], degree, scene.levels_named, base)
    known = single(degree, scene.levels_named, [name for name in scene.leveled if name], base)
    return next(setting for setting in known if (setting.knob, setting.value) == (row["knob"], row["value"]))


def _render(scene: TradeoffScene, setting: Setting) -> np.ndarray:
    """(H, W, 3) float: the first view with a setting."""
    camera = scene.cameras[0]
    model = scene.model(setting.variant, setting.levels, setting.sh_degree)
    centre = camera.width / 2, camera.height / 2
    foveation = foveation_map(Display(camera.width, camera.height), centre, setting.levels) if setting.levels > 1 else None
    return np.clip(pipeline.render(model, camera, config=setting.config, foveation=foveation, obb=setting.obb).image, 0, 1)


def crops(content: Content, path: str, variants: Sequence[tuple[str, str]] = (), size: str = SIZE) -> list[Crop]:
    """Two rows of crops of the scene's first view, at most MOST in all.

    The first row is where the last setting without foveation differs most from the default, the second where the cheapest
    setting does. The photograph is the first of each row, if there is one. Settings with another model are shown only
    if `variants` has the model.

    Args:
        content: the study's content.
        path: the scene, as for the command.
        variants: (name, path) of other models.
        size: the size of the rendered frame, WxH.
    """
    scene = load(SceneRequest(path, size, 1, tuple(variants)))
    rows = {name: row for name, row in named_rows(content) if not row["variant"] or row["variant"] in scene.leveled}
    images = {name: _render(scene, setting_of(row, scene, base_of(content))) for name, row in rows.items()}
    first = next(name for name, row in rows.items() if row["knob"] == DEFAULT)
    own = [name for name, row in rows.items() if not row["variant"]]
    flat = [name for name in own if rows[name]["knob"] not in (DEFAULT, "levels")]
    leveled = [name for name in own if rows[name]["knob"] == "levels"]
    other = [name for name, row in rows.items() if row["variant"]]
    out: list[Crop] = []
    for differs, shown in ((flat[-1:], [first, *flat[-1:]]), (leveled[-1:], [first, *leveled[-1:], *other])):
        if not differs:
            continue
        place = largest_difference(images[first], images[differs[0]])
        photograph = None if scene.photographs is None else scene.photographs[0]
        if photograph is not None:
            out.append(_crop(photograph, place, ORIGINALS[scene.world == EMBEDDED]))
        shown = shown[: COLUMNS - (photograph is not None)]
        out += [_crop(images[name], place, f"{name}: {_cost(rows[name])}") for name in shown]
    return out[:MOST]


def _cost(row: dict) -> str:
    time = f"{row['cycles'] / (1e3 * CLOCK_GHZ):,.1f} µs"
    return time if row["knob"] == DEFAULT else f"{time}, {-row['loss_db']:+.2f} dB"


def _crop(image: np.ndarray, place: tuple[int, int], caption: str) -> Crop:
    (x, y), (width, height) = place, WINDOW
    return Crop(to_bytes(image[y : y + height, x : x + width]), caption)


def sheet(crops: Sequence[Crop]) -> Image.Image:
    """The crops as one picture without words, COLUMNS to a row."""
    height, width = crops[0].pixels.shape[:2]
    gap, rows = 4, -(-len(crops) // COLUMNS)
    made = Image.new("RGB", (COLUMNS * (width + gap) - gap, rows * (height + gap) - gap), "white")
    for i, crop in enumerate(crops):
        made.paste(Image.fromarray(crop.pixels), (i % COLUMNS * (width + gap), i // COLUMNS * (height + gap)))
    return made
