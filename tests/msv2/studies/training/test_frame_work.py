"""Cycles of trained models' frames: by the model against measured frames, and frames simulated on request."""

import json
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

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
from msv2.studies import rtl_frame  # noqa: E402
from msv2.studies.cycles import cycles_of  # noqa: E402
from msv2.studies.training import rtl_cycles, tables  # noqa: E402
from msv2.studies.training.frame_work import FrameWork, foveated_frame_work, frame_work, whole_frame_work  # noqa: E402
from perf.model import MemoryModel  # noqa: E402
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


@pytest.mark.parametrize("foveated", [False, True])
def test_cycles_are_the_machines(foveated):
    """Intersections are equal, and cycles of each phase within 0.2 % of the frame in reports/."""
    measured = measured_frame(foveated)
    size = measured["size"]
    model = smfr_levels(cached_embedded_model(), 4) if foveated else cached_embedded_model()
    foveation = foveation_map(Display(*size), tuple(measured["gaze"]), 4) if foveated else None
    work = frame_work(pipeline.render(model, embedded_cameras(*size)[0], config=PAPER, foveation=foveation),
                      MemoryModel("ideal"))  # which the RTL's frames have, too
    assert work.entries == measured["entries"] and work.points == len(model) and work.tiles == measured["tiles"]
    assert work.render_cycles == pytest.approx(measured["render_cycles"], rel=2e-3)
    assert work.geometry_cycles == pytest.approx(measured["table_cycles"] + measured["geometry_cycles"], rel=2e-3)


def test_parts_of_a_frame_add_up():
    one, two = FrameWork(10, 6, 4, 100, 1000), FrameWork(20, 2, 4, 50, 500)
    assert FrameWork.total([one, two]) == FrameWork(30, 8, 4, 150, 1500)  # the tiles are those of one frame
    assert FrameWork.mean([one, two]) == FrameWork(15, 4, 4, 75, 750)
    assert one.record()["cycles"] == 1100 and one.record()["entries_per_tile"] == 1.5
    assert cycles_of(one.record()) == "cycles by the model, LPDDR3" and "version 0.1" in cycles_of({"cycles": 1})


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

    def run(command, **options):
        out = Path(command[command.index("--out") + 1])
        runs.append(out)
        numbers = {**exact, "table_cycles": 1, "geometry_cycles": 20, "render_cycles": 300, "entries": 4}
        (out / "frame.json").write_text(json.dumps(numbers))
        return SimpleNamespace(returncode=0, stdout="", stderr="")

    monkeypatch.setattr(rtl_frame.subprocess, "run", run)
    cycles = tables.simulate(scene, tmp_path)
    for _ in range(2):
        assert asdict(cycles(dense, scene.cameras[0])) == {"geometry": 21, "render": 300, "entries": 4}
    assert len(runs) == 1
    cycles(dense, scene.cameras[1])
    cycles(dense.select(torch.arange(10)), scene.cameras[0])
    assert len(set(runs)) == 3
    exact["bit_exact"] = False
    for _ in range(2):  # what was kept is as wrong
        with pytest.raises(InputError, match="differs from the golden renderer"):
            cycles(dense, scene.cameras[2])
    assert len(runs) == 4


def test_a_failing_simulation_is_told(tmp_path, monkeypatch, scene, dense):
    monkeypatch.setattr(rtl_cycles, "OPTIONS", ("--config", "absent"))
    with pytest.raises(InputError, match="config 'absent' is not accepted"):
        tables.simulate(scene, tmp_path)(dense, scene.cameras[0])
