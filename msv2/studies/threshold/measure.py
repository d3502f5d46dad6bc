"""Measures a pose at every threshold: tiles, intersections, cycles, and the HVSQ of both eyes against their references."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.metrics.binocular import BinocularHvsq, BinocularReference, EyePair
from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import StereoFrame, render_stereo
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.pipeline import Frame
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map
from golden.scenes.stereo import StereoPair, stereo_pair, warpable_tiles
from msv2.studies.cycles import MODEL
from msv2.studies.threshold.scenes import TableScene
from perf.model import MemoryModel, simulate
from perf.trace import trace_of
from spec.config import PAPER
from spec.constants import IPD_METRES
from spec.memory import BEAT_BYTES, DRAM_BYTES_PER_CYCLE
from tb.frame.bound import RENDER_READS, RENDER_WRITES, bound_cycles

CONFIG = PAPER.with_(stereo=True)
"""The machine's configuration."""

IDEAL_MEMORY = MemoryModel("ideal")
"""The memory of this study. Its cycles stand beside bounds by each stage's work, which know no rows."""

ALL = 180.0
"""A threshold in degrees beyond which no tile lies, so that both eyes are rendered."""

EyeJudge = Callable[[np.ndarray], float]
"""A function that gives the HVSQ of an eye's frame against that eye's reference."""

Judge = tuple[float, EyeJudge]
"""The HVSQ of the source eye, and the function for the target eye."""


@dataclass(frozen=True)
class TableWords:
    """A scene's models, quantised for the machine: the scene's own, the dense one, and the v1 model or None."""

    ours: GaussianWords
    dense: GaussianWords
    v1: GaussianWords | None

    @classmethod
    def of(cls, scene: TableScene) -> TableWords:
        """The quantised models of a scene, which serve all poses."""
        return cls(*(model and quantise_model(CONFIG, model) for model in (scene.model, scene.reference, scene.v1)))


def measure_pose(
    words: TableWords, camera: Camera, thresholds: Sequence[float], *, units_per_metre: float, ipd_metres: float = IPD_METRES,
) -> dict[str, object]:
    """A pose's row as JSON-ready values: `rendered` (both eyes rendered), `v1` (the same of the v1 model, or None),
    `thresholds`.

    Args:
        words: the scene's quantised models.
        camera: the source eye's camera, which looks at the centre of the frame.
        thresholds: the thresholds in degrees.
        units_per_metre, ipd_metres: the scale of the scene, and the distance between the eyes.
    """
    pair = stereo_pair(camera, units_per_metre=units_per_metre, ipd_metres=ipd_metres)
    centre = camera.width / 2, camera.height / 2
    whole = render_stereo(words.ours, pair, config=CONFIG, foveation=_foveation(words.ours, camera, centre), threshold_deg=ALL)
    gazes = whole.gaze
    shown = eyes_of(whole)
    dense = [_eye_judge(*each) for each in zip(_dense(words.dense, pair), gazes, strict=True)]
    judges = {"rendered": (0.0, _eye_judge(shown[1], gazes[1])), "dense": (dense[0](shown[0]), dense[1])}
    both = _rendered(whole, judges["dense"])
    rows = [_row(at_threshold(whole, words.ours, threshold), whole, judges, both["cycles"]) for threshold in thresholds]
    v1 = None
    if words.v1 is not None:
        frame = render_stereo(words.v1, pair, config=CONFIG, foveation=_foveation(words.v1, camera, centre), threshold_deg=ALL,
                              gaze_target=gazes[1])
        v1 = _rendered(frame, (dense[0](eyes_of(frame)[0]), dense[1]))
    return {
        "camera": camera.name, "size": [camera.width, camera.height], "gaze": [list(gaze) for gaze in gazes],
        "median_disparity_px": float(np.nanmedian(pair.disparity(whole.source.depth))),
        "cycles_by": MODEL, "rendered": both, "v1": v1, "thresholds": rows}


def at_threshold(whole: StereoFrame, words: GaussianWords, threshold_deg: float) -> StereoFrame:
    """A frame at another threshold. Its source eye, and what is warped from it, stay the same.

    Args:
        whole: the frame at any threshold.
        words: its model.
        threshold_deg: the other threshold.
    """
    display = Display(whole.pair.source.width, whole.pair.source.height)
    warp = warpable_tiles(display, whole.gaze[1], threshold_deg).reshape(-1).astype(np.int64)
    registers = replace(whole.registers, warp=warp)
    rendered = (warp == 0) | whole.warped.invalid
    target = pipeline.render_frame(whole.source.config, words, registers.target, rendered=rendered)
    return replace(whole, registers=registers, rendered=rendered, target=target, threshold_deg=threshold_deg)


def eyes_of(frame: StereoFrame) -> EyePair:
    """(H, W, 3) uint8 images of source and target eye."""
    return tuple(pixels["colour"].astype(np.uint8) for pixels in (frame.source_pixels, frame.target_pixels))


def _eye_judge(reference: np.ndarray, gaze: tuple[float, float]) -> EyeJudge:
    """The judge of one eye. Eyes are judged one at a time, because the source eye of a pose is the same at every threshold and
    judging takes longer than rendering."""
    judge = BinocularReference((reference,), (gaze,))
    return lambda image: judge((image,)).eyes[0]


def _foveation(words: GaussianWords, camera: Camera, gaze: tuple[float, float]) -> FoveationMap:
    return foveation_map(Display(camera.width, camera.height), gaze, min(words.levels, CONFIG.levels))


def _dense(words: GaussianWords, pair: StereoPair) -> EyePair:
    """Both eyes of a model of one level, each rendered as a whole, without a gaze."""
    return tuple(display_pixels(pipeline.render(words, camera, config=CONFIG))["colour"].astype(np.uint8)
                 for camera in (pair.source, pair.target))


def eye_cycles(eye: Frame) -> int:
    """Cycles of an eye that is rendered as a whole by a machine for one eye, with the ideal memory."""
    return simulate(trace_of(eye), eye.config.with_(stereo=False), memory=IDEAL_MEMORY, display=True).total


def stereo_cycles(frame: StereoFrame) -> dict[str, object]:
    """Cycles of a frame of two eyes by the cycle model with the ideal memory, as JSON-ready values.

    `source`, `target` and `total` are the cycles of the eyes and of the frame; `geometry` and `render` are those of both eyes
    by phase. `stages` is the work of the rendering stages for what is rendered, and `busiest` the largest of it. `overhead` is
    the ratio of all cycles to those that the frame would take if warping were free, which are `geometry` and `busiest`. All are
    defined as in frame.json of `python -m tb.frame`.
    """
    found = simulate(trace_of(frame), frame.source.config, memory=IDEAL_MEMORY)
    render = found.phases["render"]
    geometry = found.total - render
    beats = (sum(moved[name] for name in names) // BEAT_BYTES
             for moved, names in ((found.reads, RENDER_READS), (found.writes, RENDER_WRITES)))
    stages = bound_cycles(frame.source, found.ops, *beats, DRAM_BYTES_PER_CYCLE, second=frame.target)
    source, target = (sum(eye.values()) for eye in found.eyes)
    return {"source": source, "target": target, "total": found.total, "geometry": geometry, "render": render,
            "busiest": max(stages.values()), "stages": stages, "overhead": found.total / (geometry + max(stages.values()))}


def _hvsq(target: np.ndarray, judge: Judge) -> dict[str, float]:
    found = BinocularHvsq((judge[0], judge[1](target)))
    return {"mean": found.mean, "source": found.eyes[0], "target": found.eyes[1]}


def _rendered(frame: StereoFrame, judge: Judge) -> dict[str, object]:
    """The numbers of both eyes, rendered by a machine that warps nothing."""
    one, other = eye_cycles(frame.source), eye_cycles(frame.target)
    return {"hvsq": {"dense": _hvsq(eyes_of(frame)[1], judge)}, "entries": {"source": len(frame.source.entries.splat),
            "target": len(frame.target.entries.splat)}, "cycles": {"source": one, "target": other, "total": one + other}}


def _row(
    frame: StereoFrame, whole: StereoFrame, judges: dict[str, Judge], alone: dict[str, int],
) -> dict[str, object]:
    """The row of a threshold; `alone` holds the cycles of both eyes, each rendered by itself."""
    entries, foveal = np.diff(whole.target.entries.start), frame.registers.warp == 0
    again, cost = frame.rendered & ~foveal, stereo_cycles(frame)
    all_entries = max(int(entries.sum()), 1)
    return {
        "threshold_deg": frame.threshold_deg,
        "hvsq": {name: _hvsq(eyes_of(frame)[1], judge) for name, judge in judges.items()},
        "tiles": {"all": len(foveal), "foveal": int(foveal.sum()), "holes": int(again.sum()),
                  "warped": int((~frame.rendered).sum())},
        "pixels": {name: share for name, share in frame.shares.items() if not name.startswith("tiles")},
        "entries": {"source": len(frame.source.entries.splat), "target": len(frame.target.entries.splat),
                    "target_if_rendered": int(entries.sum()),
                    "floor_share": float(entries[foveal].sum() / all_entries),
                    "holes_share": float(entries[again].sum() / all_entries)},
        "cycles": {**cost, "of_one_eye": cost["total"] / alone["source"], "of_two_eyes": cost["total"] / alone["total"]},
        "warnings": list(frame.warnings)}
