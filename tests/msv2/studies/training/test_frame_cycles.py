"""Cycles of trained models' frames: the golden estimate against measured frames, and frames simulated on request."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from spec.paths import ROOT

torch = pytest.importorskip("torch")

from golden.msv2_ref import pipeline  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras  # noqa: E402
from golden.scenes.gaze import Display, foveation_map  # noqa: E402
from golden.scenes.levels import smfr_levels  # noqa: E402
from golden.training.baselines import SeparateModels, smfr  # noqa: E402
from golden.training.foveated import FoveatedModel  # noqa: E402
from golden.training.level_quality import frame_cost  # noqa: E402
from msv2.studies.training import rtl_cycles, tables  # noqa: E402
from msv2.studies.training.frame_cycles import FrameWork, foveated_frame_work, frame_work, whole_frame_work  # noqa: E402
from spec.config import PAPER  # noqa: E402
from spec.errors import InputError  # noqa: E402
from tests.helpers.training_samples import small_dense, small_scene  # noqa: E402


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def dense():
    return small_dense(600)


def measured_frame(foveated):
    """What the machine took for a frame of the embedded scene, from the committed report."""
    rows = json.loads((ROOT / "reports" / "frames.json").read_text())["rows"]
    return next(row for row in rows if row["scene"] == "embedded" and (row["gaze"] is not None) == foveated
                and row["merge"] and row["pipeline"])


def test_golden_cycles_are_within_three_percent_of_the_machines():
    measured = measured_frame(foveated=False)
    camera = embedded_cameras(*measured["size"])[0]
    work = frame_work(pipeline.render(cached_embedded_model(), camera, config=PAPER))
    assert work.entries == measured["entries"]
    assert abs(work.geometry_cycles / measured["geometry_cycles"] - 1) < 0.01
    assert 0.97 < work.render_cycles / measured["render_cycles"] <= 1.0


def test_geometry_beats_are_those_of_the_machine():
    """Points, colours, entries, directory slots and views of the frame in reports/, to the beat."""
    measured = measured_frame(foveated=True)
    camera = embedded_cameras(*measured["size"])[0]
    foveation = foveation_map(Display(*measured["size"]), tuple(measured["gaze"]), 4)
    work = frame_work(pipeline.render(smfr_levels(cached_embedded_model(), 4), camera, config=PAPER, foveation=foveation))
    moved = measured["dram_bytes"]
    bytes_moved = sum(moved["reads"][name] for name in ("geometry", "colour")) + sum(
        moved["writes"][name] for name in ("entries", "views"))
    assert work.entries == measured["entries"] and work.geometry_beats * 32 == bytes_moved


def test_parts_of_a_frame_add_up(scene, dense):
    frame = pipeline.render(tables.to_model(dense, up=scene.up, name="dense"), scene.cameras[0], config=PAPER)
    left = np.arange(len(frame.registers.header)) % 3 == 0
    parts = [frame_work(frame, left), frame_work(frame, ~left)]
    whole, total = frame_work(frame), FrameWork.total(parts)
    assert total.entries == whole.entries > 0 and total.array == whole.array and total.tiles == whole.tiles
    assert total.points == 2 * whole.points  # each part is a model of its own, read whole
    nothing = frame_work(frame, np.zeros_like(left))
    assert nothing.entries == nothing.survivors == nothing.array == 0 and nothing.render_cycles == 0


def test_foveated_frames_cost_what_level_quality_says(scene, dense):
    camera, nested = scene.cameras[0], smfr(dense, (600, 300, 120, 60))
    separate = SeparateModels(tuple(nested.level(level) for level in range(4)))
    works = [foveated_frame_work(levels, camera) for levels in (nested, separate)]
    for levels, work in zip((nested, separate), works, strict=True):
        cost = frame_cost(levels, camera)
        assert (work.entries, work.points) == (cost.entries, cost.projected)
    assert works[1].entries > works[0].entries  # a tile that blends lists both models
    assert works[0].entries < whole_frame_work(dense, camera).entries


def test_a_lone_level_costs_a_whole_frame(scene, dense):
    camera = scene.cameras[0]
    whole = whole_frame_work(dense, camera)
    assert foveated_frame_work(SeparateModels((dense,)), camera) == whole
    assert foveated_frame_work(FoveatedModel(dense), camera) == whole


def test_rtl_frames_are_simulated_once_and_must_be_exact(tmp_path, monkeypatch, scene, dense):
    runs, exact = [], {"bit_exact": True, "counter_errors": []}

    def simulate(folder, camera, out):
        runs.append(out)
        numbers = {**exact, "table_cycles": 1, "geometry_cycles": 20, "render_cycles": 300, "entries": 4}
        (out / "frame.json").write_text(json.dumps(numbers))

    monkeypatch.setattr(rtl_cycles, "_simulate", simulate)
    cycles = tables.simulate(scene, tmp_path)
    for _ in range(2):
        assert asdict(cycles(dense, scene.cameras[0])) == {"geometry": 21, "render": 300, "entries": 4}
    assert len(runs) == 1
    cycles(dense, scene.cameras[1])
    cycles(dense.select(torch.arange(10)), scene.cameras[0])
    assert len(set(runs)) == 3
    exact["bit_exact"] = False
    with pytest.raises(InputError, match="differs from the golden renderer"):
        cycles(dense, scene.cameras[2])


def test_a_failing_simulation_is_told(tmp_path, monkeypatch, scene, dense):
    monkeypatch.setattr(rtl_cycles, "OPTIONS", ("--config", "absent"))
    with pytest.raises(InputError, match="CONFIG 'absent' is not accepted"):
        tables.simulate(scene, tmp_path)(dense, scene.cameras[0])
