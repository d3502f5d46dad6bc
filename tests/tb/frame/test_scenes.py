"""Whole frames of real scenes through the machine: every bit, every counter, in every way of merging and pipelining, with
lists by tile (`paper_small`) and by super-tile (`default`)."""

import json

import pytest

from tb.frame import __main__ as command

pytestmark = pytest.mark.long
SIZES = {"embedded": "128x128", "truck.splat": "256x144", "rock_sh3": "192x108"}
FOVEATED = {"embedded": "64,64", "truck.splat": "128,72", "rock_sh3": "96,54", "garden_large": "160,90"}


def check(scene, path, size, foveated, out, *options, config="paper_small"):
    gaze = ["--gaze", FOVEATED[scene], "--levels", "4", "--levels-from", "random"] if foveated else []
    assert command.main([path, "--size", size, *gaze, "--config", config, "--out", str(out), *options]) == 0
    report = json.loads((out / "frame.json").read_text())
    assert report["bit_exact"] and report["counter_errors"] == report["stream_errors"] == []
    assert report["bound_cycles"] <= report["render_cycles"] < report["frame_cycles"]
    for stage, cycles in report["stage_cycles"].items():
        assert sum(cycles.values()) == report["frame_cycles"], stage
    events = report["events"]
    assert events["points"] == events["culled_near"] + events["culled_faint"] + events["culled_outside"] + report["visible"]
    if config == "default":
        assert report["stage_cycles"]["sort"]["busy"] == events["pairs"] == events["header_hits"] + events["header_misses"]
    else:
        assert report["stage_cycles"]["sort"]["busy"] == report["stage_cycles"]["array"]["busy"] == events["entries"]
        assert events["fetch_hits"] + events["fetch_misses"] == events["entries"]
    return report


@pytest.mark.parametrize("foveated", [False, True], ids=["plain", "foveated"])
@pytest.mark.parametrize("pipeline", "01")
@pytest.mark.parametrize("merge", "01")
def test_the_embedded_scene(tmp_path, foveated, merge, pipeline):
    check("embedded", "embedded", SIZES["embedded"], foveated, tmp_path, "--merge", merge, "--pipeline", pipeline)


@pytest.mark.parametrize("foveated", [False, True], ids=["plain", "foveated"])
def test_the_embedded_scene_by_super_tiles(tmp_path, foveated):
    check("embedded", "embedded", SIZES["embedded"], foveated, tmp_path, config="default")


@pytest.mark.data
@pytest.mark.parametrize("foveated", [False, True], ids=["plain", "foveated"])
@pytest.mark.parametrize("pipeline", "01")
@pytest.mark.parametrize("merge", "01")
@pytest.mark.parametrize("scene", ["truck.splat", "rock_sh3"])
def test_captured_scenes(data_dir, tmp_path, scene, foveated, merge, pipeline):
    path = str(data_dir / "trained" / scene)
    check(scene, path, SIZES[scene], foveated, tmp_path, "--merge", merge, "--pipeline", pipeline)


@pytest.mark.data
@pytest.mark.parametrize("foveated", [False, True], ids=["plain", "foveated"])
def test_a_large_scene(data_dir, tmp_path, foveated):
    check("garden_large", str(data_dir / "trained" / "garden_large"), "320x180", foveated, tmp_path)
