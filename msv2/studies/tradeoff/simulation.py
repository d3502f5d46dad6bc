"""Measures the cost of simulation: oracle, float32 kernel, integer renderer, cycle model and RTL on the same frame."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from golden.host.quantise import quantise_model
from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import pipeline
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.scenes.request import parse_request, resolve
from msv2.studies.rtl_frame import kept_frame
from msv2.studies.speed import float32
from msv2.studies.tradeoff.scene import SceneRequest, first_level, load, run_scene
from perf.frames import simulate, trace_of
from perf.model import MemoryModel
from spec.config import CONFIGS
from spec.errors import InputError
from spec.paths import REPORTS

Row = dict[str, object]
REPEATS = 3

def best_of(work: Callable[[], object], repeats: int = REPEATS) -> tuple[float, object]:
    """The least wall time of several calls in seconds, and the last result. A first call, which compiles, is not timed."""
    result, best = work(), float("inf")
    for _ in range(repeats):
        begin = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - begin)
    return best, result


def renderers(request: SceneRequest, config_name: str, rtl: Mapping[str, object] | None = None) -> list[Row]:
    """A row for each way to render level 1 with camera 0.

    Wall times are upper bounds if the machine does other work. `cycle_error` is relative to the RTL's cycles for this frame.
    Without `rtl` it is the worst error of the frames in reports/model.json.

    Args:
        request: the scene.
        config_name: the machine.
        rtl: the result of `played` for the same request and machine, or None.
    """
    config, (model, camera) = CONFIGS[config_name], _frame(request)
    rows: list[Row] = []

    begin = time.perf_counter()
    ideal = render_oracle(model, camera).image
    rows.append(_row("oracle", "float64, to be read", time.perf_counter() - begin, ideal, ideal))
    kept = float32.prepare(model)
    seconds, frame = best_of(lambda: float32.render(kept, camera))
    rows.append(_row("float kernel", "float32, numba", seconds, frame.image.astype(np.float64), ideal))
    words = quantise_model(config, model)
    seconds, golden = best_of(lambda: pipeline.render(words, camera, config=config))
    rows.append(_row("integer golden", "every bit of the RTL", seconds, golden.image, ideal))

    ideal_memory = MemoryModel("ideal")  # that of the RTL's frame beside it
    more, frame = best_of(lambda: simulate(trace_of(golden), config, memory=ideal_memory))
    row = _row("cycle model", "golden, its trace, and the model", seconds + more, golden.image, ideal)
    row["cycles"] = frame.total - frame.phases["clear"]  # the phases in frame.json do not include it
    rows.append(row)
    if rtl:
        other = _row("RTL", f"Verilator, bit exact: {rtl['bit_exact']}", rtl["wall_s"], golden.image, ideal)
        other["cycles"] = rtl["table_cycles"] + rtl["geometry_cycles"] + rtl["render_cycles"]
        row["cycle_error"] = row["cycles"] / other["cycles"] - 1
        other["cycle_error"] = 0.0
        rows.append(other)
    else:
        row["cycle_error"], row["cycle_error_of"] = _worst_known(), "worst frame of reports/model.json"
    return rows


def _frame(request: SceneRequest) -> tuple[GaussianModel, Camera]:
    """Level 1, and the camera that command lines call 0, so that the RTL gets the same one. For a run's folder it is the first
    view."""
    if run_scene(request.path):
        scene = load(request)
        return scene.model("", 1, None), scene.cameras[0]
    shown = resolve(parse_request(request.path, "--size", request.size, "--camera", "0"))
    return first_level(shown.model), shown.camera


def _row(name: str, what: str, seconds: float, image: np.ndarray, ideal: np.ndarray) -> Row:
    return {"name": name, "what": what, "wall_s": seconds, "psnr_oracle_db": min(psnr_vs(image, ideal), 200.0),
            "max_abs_error": max_abs_error(image, ideal), "cycles": None, "cycle_error": None}


def _worst_known() -> float | None:
    path = REPORTS / "model.json"
    if not path.exists():
        return None
    rows = json.loads(path.read_text()).get("rows", [])
    return max((abs(row["total"]["error"]) for row in rows), default=None)


def played(request: SceneRequest, config_name: str) -> Row:
    """The frame.json of the first view on the RTL (minutes, and at the first time a build).

    Raises:
        InputError: the RTL's bits differ from the golden renderer's, or it did not finish; or the request is the folder of a
            run, whose views the RTL's command line cannot name.
    """
    if run_scene(request.path):
        raise InputError(f"{request.path} is not accepted with --rtl: a model is, or embedded")
    options = ["--machine", "full", "--camera", "0", "--size", request.size, "--config", config_name]
    return kept_frame(Path(request.work) / "rtl", request.path, options)
