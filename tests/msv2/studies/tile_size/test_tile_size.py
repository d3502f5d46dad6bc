"""Tiles of other sizes: counts that must hold whatever the scene, the bound beside the cycle model, the page."""

from __future__ import annotations

import json

import numpy as np
import pytest

from golden.oracle.project import project
from golden.scenes.request import parse_request, resolve
from msv2.studies.tile_size import study
from msv2.studies.tile_size.area import array_mm2, tile_memory_mm2
from msv2.studies.tile_size.measure import ARRAYS, SIZES, Array, footprint_pixels, foveation_of, measured
from msv2.studies.tile_size.page import page
from perf.model import MemoryModel, simulate
from perf.trace import trace_request
from spec.config import PAPER
from spec.paths import DOCS, REPORTS

ARGUMENTS = ("embedded", "--size", "128x80", "--gaze", "40,30", "--levels", "4")


@pytest.fixture(scope="module")
def frame() -> dict:
    return measured(resolve(parse_request(*ARGUMENTS)))


def test_larger_tiles_have_fewer_intersections_and_idler_cores(frame):
    sizes = {size["tile"]: size for size in frame["sizes"]}
    assert tuple(sizes) == SIZES
    counts = [sizes[tile]["intersections"] for tile in SIZES]
    assert counts[0] > counts[1] > counts[2] and counts[0] < 4 * counts[1] < 16 * counts[2]
    assert [sizes[tile]["mean"] for tile in SIZES] == sorted(sizes[tile]["mean"] for tile in SIZES)
    used = {(a["tile"], a["cores"]): a["utilisation"] for a in frame["arrays"]}
    assert 1 > used[8, 8] > used[16, 16] > used[32, 32] > 0
    assert used[16, 8] == pytest.approx(used[16, 16])  # every block takes every operation


def test_counts_at_sixteen_pixels_are_those_of_the_machine(frame):
    trace = trace_request(parse_request(*ARGUMENTS), PAPER)
    here = next(size for size in frame["sizes"] if size["tile"] == 16)
    assert trace.entries == pytest.approx(here["intersections"], rel=0.02)
    for array in ARRAYS:
        if array.expressible:
            bound = next(a for a in frame["arrays"] if (a["tile"], a["cores"]) == (16, array.cores))
            model = simulate(trace, PAPER.with_(cores_x=array.cores, cores_y=array.cores), memory=MemoryModel("ideal"),
                             display=True)
            assert model.total == pytest.approx(bound["cycles"], rel=0.2)
            assert model.ops <= bound["operations"] * 1.02 + array.blocks * 2 * len(trace.eyes[0].counts)


def test_pixels_of_footprints_by_brute_force():
    """Each pixel by itself against the exact exponent of each splat."""
    asked = resolve(parse_request("embedded", "--size", "48x32"))
    splats, _ = project(asked.model, asked.camera, PAPER.support_sigma)
    of, count = foveation_of(asked, 16), 0
    x, y = np.meshgrid(np.arange(48) + 0.5, np.arange(32) + 0.5)
    for mean, factor, q_max in zip(splats.mean2d, splats.factor, splats.q_max, strict=True):
        dx, dy = x - mean[0], y - mean[1]
        q = ((factor[0] * dx + factor[1] * dy) ** 2 + (factor[2] * dy) ** 2) / 2
        count += int((q <= q_max[0]).sum())
    assert footprint_pixels(splats, of) == pytest.approx(count, rel=1e-3)


def test_areas():
    area = {(a.tile, a.cores): array_mm2(a) for a in ARRAYS}
    assert area[8, 8] < area[16, 8] < area[16, 16] < area[32, 16] < area[32, 32]
    assert area[32, 32] == pytest.approx(4 * area[16, 16], rel=0.01) and area[16, 16] == pytest.approx(4 * area[8, 8], rel=0.01)
    memories = [tile_memory_mm2(tile) for tile in SIZES]
    assert memories == sorted(memories, reverse=True) and memories[0] == pytest.approx(4 * memories[1], rel=0.05)
    assert Array(32, 16).blocks == 4 and Array(32, 16).name == "16x16"


def test_the_page_is_that_of_the_report():
    text = page(json.loads((REPORTS / "tile_size.json").read_text()))
    assert (DOCS / "tile_size.md").read_text(encoding="utf-8") == text
    for array in ARRAYS:
        assert f"| {array.tile} | {array.name} |" in text


def test_the_command_writes_into_build(tmp_path, monkeypatch, frame):
    modelled = {"ideal": {"8x8": 7, "16x16": 6}, "lpddr3": {"8x8": 9, "16x16": 8}}
    row = {"scene": "embedded", "size": "128x80", **frame, "golden_intersections": 5, "model_cycles": modelled}
    monkeypatch.setattr(study, "frames", lambda: iter([row]))
    assert study.main(["--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "tile_size.json").read_text())["frames"][0]["points"] == frame["points"]
    assert (tmp_path / "out" / "tile_size.md").read_text().startswith("# Why a tile has 16 pixels")
