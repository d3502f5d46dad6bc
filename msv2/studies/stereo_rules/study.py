"""Compares rules for filling the holes of a warped eye, and finds why tiles are rendered again: reports/stereo_rules.json and
.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from golden.metrics.hvsq import Hvsq, foveated
from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline, warp
from golden.msv2_ref.eyes import StereoFrame, render_stereo
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels
from golden.scenes.gaze import Display
from golden.scenes.request import Request
from golden.scenes.stereo import scene_scale, stereo_pair
from msv2.studies.accuracy.stereo import with_gaze
from msv2.studies.accuracy.study import keep, over_scenes
from msv2.studies.page import table
from spec.config import PAPER, WARP_FILLS, AcceleratorConfig
from spec.constants import MAX_LEVELS, TILE

TRAINED = (Path("build/train/bonsai/model.ply"),)
"""Models trained by this project, which are measured if they exist."""

RULES = {"interior": {"warp_fill": "interior"}, "majority": {"warp_fill": "majority"},
         "interior, veiled": {"warp_fill": "interior", "warp_veiled": True},
         "majority, veiled": {"warp_fill": "majority", "warp_veiled": True}}
"""The compared rules of filling and warping, as changes of the configuration."""

NOTE = """\
Thresholds of 18 degrees around a gaze in the centre. Scenes whose scale is unknown at 1 unit per metre. Four levels are a
trained model's, or nested random subsets, worse than trained ones: walls let through what is behind.

First table, of each rule: tiles rendered again, the target against rendering it whole, and binocular HVSQ against both eyes in
level 1: of four levels relative to the rendered pair's. `interior`: five neighbours fill a hole; `majority`: more than half of
those that exist in strip and frame; `veiled`: pixels of a coverage below one half are warped too.

Last tables: of the tiles rendered again, those with holes of a cause, and those with holes of that one alone: a veiled source
pixel would have come here; the row's run of holes reaches the frame's side; is one pixel, two pixels, or more."""


def causes(frame: StereoFrame, machine: AcceleratorConfig) -> dict[str, dict[str, float]]:
    """The causes for which tiles are rendered again: the share of these tiles with holes of each cause, and with holes of that
    cause alone.

    Args:
        frame: the frame of two eyes.
        machine: the configuration with a rule of filling; its veiled pixels are not warped.
    """
    registers, source = frame.registers, frame_pixels(frame.source)
    valid, seen = (
        warp.warp(machine.with_(warp_veiled=veiled), source, registers.disparity_scale, registers.source_right)
        for veiled in (False, True))
    holes, left = valid.strips["valid"] == 0, valid.origin == warp.HOLE
    wide, side = _runs(holes)
    veiled = seen.strips["valid"] == 1
    kinds = {"veiled": veiled, "side": ~veiled & side, "one pixel": ~veiled & ~side & (wide == 1),
             "two pixels": ~veiled & ~side & (wide == 2), "disocclusion": ~veiled & ~side & (wide > 2)}
    again = valid.invalid & (registers.warp == 1)
    tiles = {name: warp.tiles_with(left & kind) & again for name, kind in kinds.items()}
    number = sum(kind.astype(int) for kind in tiles.values())
    most = max(again.sum(), 1)
    return {name: {"any": float(kind.sum() / most), "alone": float((kind & (number == 1)).sum() / most)}
            for name, kind in tiles.items()}


def _runs(holes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each hole, the length of its run of holes in the row, and whether the run reaches the frame's side; both (H, W)."""
    length, side = np.zeros(holes.shape, int), np.zeros(holes.shape, bool)
    for y, row in enumerate(holes):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]]))).reshape(-1, 2)
        for begin, end in edges:
            length[y, begin:end], side[y, begin:end] = end - begin, begin == 0 or end == len(row)
    return length, side


def rules(frame: StereoFrame, whole: np.ndarray, first: tuple[np.ndarray, np.ndarray]) -> dict[str, dict[str, float | None]]:
    """The target eye's quality under each rule of filling and warping.

    Args:
        frame: the frame of two eyes.
        whole: (H, W) DisplayPixel records of the target eye, rendered as a whole.
        first: both eyes in level 1 everywhere, source and target.
    """
    registers, source = frame.registers, frame.source_pixels["colour"].astype(np.uint8)
    target = whole["colour"].astype(np.uint8)
    unmoved = _judge(first[0], frame.gaze[0], source)  # the source eye is the same under every rule
    to_whole, to_first = (_reference(eye, frame.gaze[1]) for eye in (target, first[1]))

    found = {"rendered": {"hvsq_level_1": (unmoved + _hvsq(to_first, target)) / 2}}
    for name, changes in RULES.items():
        warped = warp.warp(frame.source.config.with_(**changes), frame_pixels(frame.source), registers.disparity_scale,
                                registers.source_right)
        rendered = (registers.warp == 0) | warped.invalid
        again = _per_pixel(rendered, whole.shape)
        shown = np.where(again[..., None], target, warped.pixels["colour"]).astype(np.uint8)
        a, b = shown / 255.0, target / 255.0
        found[name] = {
            "rerendered": float((rendered & (registers.warp == 1)).mean()),
            "filled": float((~again & (warped.origin == warp.FILLED)).mean()),
            "psnr_target_db": psnr_vs(a, b), "psnr_warped_db": None if again.all() else psnr_vs(a[~again], b[~again]),
            "hvsq_pair": _hvsq(to_whole, shown) / 2, "hvsq_level_1": (unmoved + _hvsq(to_first, shown)) / 2}
    return found


def _reference(eye: np.ndarray, gaze: tuple[float, float]) -> Hvsq:
    height, width = eye.shape[:2]
    return foveated(torch.from_numpy(eye / np.float32(255)), Display(width, height).eccentricity(gaze))


def _hvsq(reference: Hvsq, eye: np.ndarray) -> float:
    with torch.no_grad():
        return float(reference(torch.from_numpy(eye / np.float32(255))))


def _judge(reference: np.ndarray, gaze: tuple[float, float], eye: np.ndarray) -> float:
    return 0.0 if np.array_equal(reference, eye) else _hvsq(_reference(reference, gaze), eye)


def _per_pixel(tiles: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    rows = -(-shape[0] // TILE)
    return tiles.reshape(rows, -1).repeat(TILE, axis=0).repeat(TILE, axis=1)[: shape[0], : shape[1]]


def measure(request: Request, name: str) -> dict[str, object]:
    """One row of the report, for a request with a gaze."""
    camera = request.camera
    pair = stereo_pair(camera, units_per_metre=scene_scale(name, None)[0])
    frame = render_stereo(request.model, pair, config=PAPER.with_(stereo=True), foveation=request.foveation)
    config, words = frame.source.config, frame.source.words
    whole = display_pixels(pipeline.render_frame(config, words, frame.registers.target))
    first = tuple(display_pixels(pipeline.render(words, eye, config=config))["colour"].astype(np.uint8)
                  for eye in (pair.source, pair.target))
    return {
        "scene": name, "camera": camera.name, "size": [camera.width, camera.height], "levels": request.foveation.levels,
        "median_disparity_px": float(np.nanmedian(pair.disparity(frame.source.depth))), "shares": frame.shares,
        "rules": rules(frame, whole, first),
        "causes": {fill: causes(frame, config.with_(warp_fill=fill)) for fill in WARP_FILLS},
    }


def as_markdown(rows: list[dict[str, object]]) -> str:
    """The tables of reports/stereo_rules.md."""
    lines = []
    for r in rows:
        base = r["rules"]["rendered"]["hvsq_level_1"]
        cells = []
        for rule in (r["rules"][name] for name in RULES):
            judged = (f"{rule['hvsq_level_1'] / base - 1:+.2%}" if base else f"{1e5 * rule['hvsq_level_1']:.2f}e-5")
            cells.append(f"{rule['rerendered']:.1%}, {rule['psnr_target_db']:.1f} dB, {judged}")
        lines.append(_line(r, f"{r['shares']['tiles_foveal']:.1%}", *cells))
    tables, names = [table(["scene, view", "levels", "foveal tiles", *RULES], lines)], list(rows[0]["causes"][WARP_FILLS[0]])
    for fill in WARP_FILLS:
        lines = []
        for r in rows:
            shares = r["causes"][fill]
            lines.append(_line(r, *(f"{shares[name]['any']:.0%}, {shares[name]['alone']:.0%}" for name in names)))
        tables.append(table([f"{fill}: scene, view", "levels", *names], lines))
    return "\n\n".join([*tables, NOTE]) + "\n"


def _line(row: dict[str, object], *cells: str) -> list[object]:
    return [f"{row['scene']}, {row['camera']}", row["levels"], *cells]


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    rows, args = over_scenes("stereo_rules", __doc__, argv, lambda request, scene: [
        measure(with_gaze(request, levels), named(request, scene)) for levels in (1, MAX_LEVELS)], TRAINED)
    keep(args, "stereo_rules", __name__, {"rows": rows}, as_markdown(rows))
    return 0


def named(request: Request, scene: str) -> str:
    """A scene's name. A trained model is named after its folder."""
    path = Path(str(request.record["scene"]))
    return path.parent.name if path.name == "model.ply" else scene
