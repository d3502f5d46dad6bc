"""The frames on which machines are compared. The golden renderer renders each of them once; their traces are kept."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.msv2_ref.eyes import render_stereo
from golden.scenes.captured import captured_path
from golden.scenes.files import atomic_output
from golden.scenes.level_source import RANDOM
from golden.scenes.load import EMBEDDED
from golden.scenes.request import parse_request, parse_size, resolve
from golden.scenes.stereo import scene_scale, stereo_pair
from msv2.studies.kept import fingerprint
from msv2.studies.scenes import MODELS
from msv2.studies.scenes import TRAINED_HERE as TRAINED
from perf.frames import Trace, trace_request
from perf.gscore import GscoreTrace, gscore_trace
from perf.trace import FrameTrace, load_trace, save_trace, trace_of
from spec.config import PAPER, V3, V3_RECORDS, V3_STREAMS, AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG
from spec.errors import InputError
from spec.paths import ROOT, cache_folder

SPATIAL = PAPER.with_(name="paper_spatial", order="spatial")
CHUNKS = SPATIAL.with_(name="chunks_wide", chunks=True)
"""The first steps from PAPER to V3: the order of the model, which is the host's work alone, and chunks of wide records."""

TRACED = (SPATIAL, CHUNKS, V3_RECORDS, V3, V3_STREAMS)
"""The machines that have traces of their own besides PAPER; packing, buckets and hand-over change no trace."""

CACHE, STEP_CACHE = cache_folder("compared"), cache_folder("traces")
TWO_EYES = PAPER.with_(stereo=True)
LEVELS = 4

SECOND_VIEW = "3"
"""The second camera: one of the orbit's eight, or one of a scene's cameras, far from the first."""

_ALL_TILES = 180.0  # degrees; no tile lies beyond this eccentricity, so that none is warped


@dataclass(frozen=True)
class Compared:
    """A frame with the gaze in its centre.

    Attributes:
        name: scene and camera.
        scene: the scene alone. trained: whether its levels are trained.
        frame: the trace of one eye.
        other: the trace of the other eye, rendered as a whole.
        warped: the trace of both eyes, with the second one warped beyond the threshold.
        gscore: the first eye's trace for the GSCore-like machine.
        steps: the traces of one eye for the machines of TRACED, by their names.
        subject: the request, as in the record beside a picture.
    """

    name: str
    scene: str
    trained: bool
    frame: FrameTrace
    other: FrameTrace
    warped: FrameTrace
    gscore: GscoreTrace
    steps: Mapping[str, Trace]
    subject: dict[str, object]


def scene_file(scene: str) -> Path | None:
    """The path of a captured scene, of a scene that was trained here, or of a model file; None if it does not exist."""
    captured = captured_path(scene) if scene in MODELS and scene != EMBEDDED else None
    places = [captured, ROOT / "build" / "train" / scene / "model.ply", Path(scene)]
    return next((place for place in places if place is not None and place.exists()), None)


def scenes_here() -> tuple[list[str], list[str]]:
    """The names of the scenes that are present, the embedded one first, and of those that are missing."""
    found = {scene: scene_file(scene) is not None for scene in (*MODELS[1:], *TRAINED)}
    return [EMBEDDED, *(s for s, there in found.items() if there)], [s for s, there in found.items() if not there]


def request(scene: str, size: str, camera: str = "orbit") -> argparse.Namespace:
    """The parsed arguments of a frame.

    Raises:
        InputError: the scene is missing.
    """
    path = EMBEDDED if scene == EMBEDDED else scene_file(scene)
    if path is None:
        raise InputError(f"SCENE {scene!r} is not accepted: 'embedded', a model file, a scene of MSV2_DATA or build/train are")
    width, height = parse_size(size)
    gaze = f"{width / 2:g},{height / 2:g}"
    return parse_request(str(path), "--size", size, "--gaze", gaze, "--levels", str(LEVELS), "--levels-from", RANDOM,
                         "--camera", camera)


def compared(scene: str, size: str, camera: str = "orbit", *, config: AcceleratorConfig = TWO_EYES) -> Compared:
    """The traces of a frame, from the cache if none of its inputs has changed.

    Raises:
        InputError: the scene is missing, or the request is not valid.
    """
    args = request(scene, size, camera)
    folder = CACHE / _key(args, config)
    found = _load(folder)
    if found is None:
        found = _render(args, config)
        for name, trace in zip(("frame", "other", "warped"), found[:3], strict=True):
            save_trace(trace, folder / f"{name}.npz")
        with atomic_output(folder / "gscore.npz") as file:
            np.savez_compressed(file, **found[3]._asdict())
    name = Path(scene).stem + ("" if camera == "orbit" else f", view {camera}")
    steps = {machine.name: trace_request(args, machine, cache=STEP_CACHE) for machine in TRACED}
    return Compared(name, scene, scene in TRAINED, *found, steps, found[0].record)


def _key(args: argparse.Namespace, config: AcceleratorConfig) -> str:
    files = [(path.stat().st_size, path.stat().st_mtime_ns) for path in map(Path, (args.scene, args.camera)) if path.exists()]
    return fingerprint(("perf.trace", "perf.gscore"), sorted(vars(args).items()), ECC_THRESHOLD_DEG, config, files)


def _load(folder: Path) -> tuple[FrameTrace, FrameTrace, FrameTrace, GscoreTrace] | None:
    paths = [folder / f"{name}.npz" for name in ("frame", "other", "warped", "gscore")]
    if not all(path.is_file() for path in paths):
        return None
    traces = [load_trace(path) for path in paths[:3]]
    if None in traces:
        return None
    with np.load(paths[3]) as file:
        numbers = {name: file[name] if file[name].ndim else int(file[name]) for name in GscoreTrace._fields}
    return (*traces, GscoreTrace(**numbers))


def _render(args: argparse.Namespace, config: AcceleratorConfig) -> tuple[FrameTrace, FrameTrace, FrameTrace, GscoreTrace]:
    """Traces of one eye, of the other eye as a whole, and of both with the other one warped."""
    begin, asked = time.perf_counter(), resolve(args)
    units, _ = scene_scale(asked.model.name, None)
    pair = stereo_pair(asked.camera, units_per_metre=units)
    both = {"config": config, "foveation": asked.foveation, "background": asked.background}
    whole = render_stereo(asked.model, pair, threshold_deg=_ALL_TILES, **both)
    warped = render_stereo(asked.model, pair, source=whole.source, **both)
    seconds = time.perf_counter() - begin
    return (*(trace_of(eye, seconds=seconds, record=asked.record) for eye in (whole.source, whole.target, warped)),
            gscore_trace(whole.source))


def default_frames(scenes: list[str]) -> Iterator[tuple[str, str]]:
    """Scene and camera of every frame of a report: two cameras per scene."""
    for scene in scenes:
        for camera in ("orbit", SECOND_VIEW):
            yield scene, camera
