"""The tile test: its parts in Amaranth's simulator, the whole in Verilator against the golden renderer.

A run every cycle and one every eight are quick; PAPER and PAPER_SMALL, and scenes, are long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from golden.msv2_ref.tile_test import tile_test
from rtl.culling.level_table import LevelTable
from rtl.culling.schedule import cost, schedule
from rtl.culling.tile_columns import falloff_format, tile_columns
from rtl.culling.tile_expand import TileExpand
from rtl.culling.tile_runs import TileRuns, run_layout
from rtl.culling.tile_test import TileTest
from spec import tables
from spec.config import PAPER, TINY, NumberFormats
from spec.constants import TILE
from spec.formats import SmallFloat
from spec.queues import LEVEL_GROUP
from spec.records import intersection_item, projected_splat, tile_level
from tb.common.exact import problems
from tb.culling import tile_test_suite
from tb.culling.tile_test_stimuli import Case, random_case, random_levels, random_splats, sharp_case
from tests.helpers.rtl_streams import assert_rejected, exchange

FAST = TINY.with_(culling_units=8, row_width=288)  # a run a cycle, rows of two groups of tiles and an odd one

NARROW = NumberFormats(
    position=SmallFloat(sig_bits=14, exp_bits=8, bias=127), view=SmallFloat(sig_bits=14, exp_bits=8, bias=127),
    work=SmallFloat(sig_bits=12, exp_bits=8, bias=127), conic=SmallFloat(sig_bits=10, exp_bits=6, bias=63))


class _Walk(wiring.Component):
    """Table and walk as the unit wires them; splats wait for the table."""

    def __init__(self, config, width, height):
        self._config, self._size = config, (-(-width // TILE), -(-height // TILE))
        self._runs, self._levels = TileRuns(config), LevelTable(config)
        super().__init__({
            "splats": In(self._runs.splats.signature.flip()), "table": In(self._levels.table.signature.flip()),
            "runs": Out(self._runs.runs.signature)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.walk, m.submodules.levels = walk, levels = self._runs, self._levels
        wiring.connect(m, wiring.flipped(self.table), levels.table)
        wiring.connect(m, walk.runs, wiring.flipped(self.runs))
        m.d.comb += [
            levels.enable.eq(walk.enable), levels.row.eq(walk.row), levels.group.eq(walk.group), walk.codes.eq(levels.codes),
            walk.row_start.eq(levels.row_start), levels.tiles_x.eq(self._size[0]), levels.tiles_y.eq(self._size[1]),
            walk.splats.payload.eq(self.splats.payload), walk.splats.valid.eq(self.splats.valid & levels.filled),
            self.splats.ready.eq(walk.splats.ready & levels.filled)]
        return m


def runs_of(splats: np.ndarray, levels: np.ndarray, tiles_x: int) -> list[tuple]:
    """(index, row, first column, last column, level, blend, last of the splat) of every run, one column at a time."""
    found = []
    for splat in splats:
        rows = range(splat["first_y"], splat["last_y"] + 1)
        for row in rows:
            columns = range(splat["first_x"], splat["last_x"] + 1)
            codes = {column: tuple(levels[row * tiles_x + column].tolist()) for column in columns}
            begin = columns[0]
            for column in columns:
                if column == columns[-1] or column % LEVEL_GROUP == LEVEL_GROUP - 1 or codes[column] != codes[column + 1]:
                    ends = int(column == columns[-1] and row == rows[-1])
                    found.append((int(splat["bound"]), row, begin, column, *codes[column], ends))
                    begin = column + 1
    return found


@pytest.mark.parametrize("pauses", [0, 0.5])
@pytest.mark.parametrize("kind", ["one", "alternating", "random", "stretches"])
def test_walk_cuts_boxes_into_runs_one_a_cycle(kind, pauses):
    rng, width, height = np.random.default_rng(len(kind)), 288, 70
    splats, levels = random_splats(FAST, rng, 40, width, height, "discs"), random_levels(rng, 18, 5, kind)
    table = np.zeros(len(levels), tile_level(FAST).dtype)
    table["level"], table["blend"] = levels.T
    end = np.zeros(1, splats.dtype)
    end["end"] = 1
    dut, shape = _Walk(FAST, width, height), run_layout(FAST)
    words = [projected_splat(FAST).pack(row) for row in np.concatenate([splats, end])]
    expected = runs_of(splats, levels, 18)
    got, cycles = exchange(
        dut, {dut.splats: words, dut.table: [tile_level(FAST).pack(row) for row in table]}, dut.runs, len(expected) + 1,
        pauses=pauses)
    runs = [shape.from_bits(word) for word in got]
    assert [
        (r.splat.bound, r.row, r.group * LEVEL_GROUP + r.begin, r.group * LEVEL_GROUP + r.stop, r.code.level, r.code.blend,
         r.last) for r in runs[:-1]] == expected
    assert all(r.tile == r.row * 18 + r.group * LEVEL_GROUP for r in runs[:-1])
    assert [r.end for r in runs] == [0] * len(expected) + [1]
    if not pauses:
        assert cycles[-1] - cycles[0] == len(expected)


def test_expansion_costs_a_cycle_an_entry_and_a_cycle_a_run_without():
    """One splat: two runs of three tiles, of which the ellipse leaves two and none, a rejected one, and one that passes."""
    dut = TileExpand(FAST)
    plan = {"tile": 36, "group": 0, "begin": 4, "stop": 6, "level": 1, "passes": 1, "last": 0, "end": 0}
    runs = [
        {"first": 5, "last": 17, "none": 0, "carried": plan},
        {"first": 9, "last": 17, "none": 0, "carried": plan},
        {"first": 0, "last": 0, "none": 1, "carried": plan},
        {"first": 0, "last": 17, "none": 0, "carried": plan | {"passes": 0, "level": 3}},
        {"first": 0, "last": 17, "none": 0, "carried": plan | {"tile": 52, "group": 1, "begin": 1, "stop": 1, "last": 1}},
        {"first": 0, "last": 0, "none": 0, "carried": plan | {"end": 1}}]
    shape = dut.runs.payload.shape()

    def setup(ctx):
        ctx.set(dut.survivors.ready, 1)

    got, cycles = exchange(
        dut, {dut.runs: [shape.const(run).as_bits() for run in runs], dut.splats: [1]}, dut.entries, 4, setup=setup)
    entries = [intersection_item(FAST).unpack(word) for word in got]
    assert [entry["tile"] for entry in entries] == [36 + 5, 36 + 6, 36 + 17, 0]
    assert [entry["end"] for entry in entries] == [0, 0, 0, 1]
    assert np.diff(cycles).tolist() == [1, 4, 1]


@pytest.fixture(scope="module", params=[TINY, FAST], ids=["tiny", "fast"])
def played(request, tmp_path_factory):
    """A machine, its plan and outcome."""
    plan = tile_test_suite.unit_plan(request.param, 0)
    return request.param, plan, tile_test_suite.run_plan(request.param, plan, tmp_path_factory.mktemp("tiles"))


def test_every_entry_and_survivor_is_the_golden_ones_and_no_cycle_is_lost(played):
    _, plan, outcome = played
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 30_000
    assert sum(item.most_cycles is not None for item in plan) == 8


def test_pairs_of_tiles_that_are_not_rendered_are_dropped(tmp_path):
    config, rng = tile_test_suite.VARIANTS["tiny_stereo"], np.random.default_rng(3)
    cases = [random_case(config, rng, f"tiles rendered, {k}", 170, 90, 60, frames=3, kind=kind)
             for k, kind in enumerate(("one", "rings", "random"))]
    for item in cases:
        masks = [np.arange(66) % 11 < 5, np.zeros(66, bool), rng.random(66) < 0.5]
        assert len(masks) == len(item.frames) == len(item.rendered)
    cases = [replace(item, rendered=tuple(masks)) for item in cases]
    everything = [replace(item, rendered=()) for item in cases]
    for item, whole in zip(cases, everything, strict=True):
        for golden, other in zip(item.golden, whole.golden, strict=True):
            assert golden.touched == other.touched and golden.filtered > other.filtered
        assert len(item.golden[1].entries) == len(item.golden[1].survivors) == 1
    plan = [tile_test_suite.plan_of(item, reset=False, most_cycles=tile_test_suite.most_cycles(item)) for item in cases]
    plan += [tile_test_suite.plan_of(item, f"{item.name}, all", reset=False) for item in everything]
    outcome = tile_test_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan)


def test_faults_are_found(played):
    _, plan, outcome = played
    item = next(item for item in plan if item.name == "discs in rings")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port in ("entries", "survivors"):
        for name in item.expected[port].dtype.names:
            rows = item.expected[port].copy()
            rows[name][3] ^= 1
            wrong = problems(replace(item, expected=item.expected | {port: rows}), recording)
            assert len(wrong) == 1 and wrong[0].startswith(f"{port} 3: ")
    for name, value in item.observed.items():
        assert problems(replace(item, observed={name: value + 1}), recording) == [f"{name} is {value}, not {value + 1}"]


@pytest.mark.parametrize("shape", ["discs", "needles", "giants"])
def test_stimuli_reach_what_they_are_meant_to(shape):
    """Rejected pairs, runs without tiles, runs of several, splats without entries: all of them often."""
    case = random_case(FAST, np.random.default_rng(1), "", 280, 100, 300, frames=1, shape=shape, kind="rings")
    (cost,), (golden,) = case.costs(), case.golden
    assert cost.runs > 1.2 * cost.emitting and cost.entries > 1.2 * cost.emitting
    assert 100 < golden.filtered < golden.touched - 100 and 50 < len(golden.survivors) < 250
    levels = golden.survivors["levels"][:-1]
    assert all((levels >> k & 1).any() for k in range(4)) and (levels & levels - 1).any()


def test_an_ulp_decides_where_it_is_meant_to():
    """Means moved by an ulp give other tiles, for each of many splats of every shape."""
    case = sharp_case(FAST, np.random.default_rng(0), 100)
    for splats, levels in case.frames:
        moved = {d: splats.copy() for d in (-1, 1)}
        for d, copy in moved.items():
            copy["mean2d"][:, 0] += d
        lists = [tile_test(FAST, each, levels, case.width, case.height).entries for each in (splats, *moved.values())]
        assert len(splats) > 60 and all(not np.array_equal(lists[0], other) for other in lists[1:])


@pytest.mark.long
@pytest.mark.parametrize("config", tile_test_suite.VARIANTS.values(), ids=tile_test_suite.VARIANTS)
def test_scenes_are_exact(config, tmp_path):
    """The embedded scene always, trained ones where they are; rates are held by the plan."""
    plan = tile_test_suite.full_plan(config, 1)
    outcome = tile_test_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(tile_test_suite.figures(config, plan, outcome)) >= 4


@pytest.mark.long
@pytest.mark.parametrize("change", [
    {"support_sigma": None}, {"support_sigma": 8.0, "culling_units": 2}, {"row_width": 112},
    {"support_sigma": 0.5, "row_width": 4096, "culling_units": 8}, {"formats": NARROW},
], ids=["no support", "wide support", "seven tiles", "wide frames", "narrow formats"])
def test_other_machines_are_exact(change, tmp_path):
    config = TINY.with_(**change)
    assert tile_test_suite.run_plan(config, tile_test_suite.unit_plan(config, 2), tmp_path).failures == {}


def test_figures_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = tile_test_suite.traced_plan(FAST, "96x64")
    outcome = tile_test_suite.run_plan(FAST, plan, tmp_path / "run")
    lines = tile_test_suite.figures(FAST, plan, outcome)
    assert outcome.failures == {} and len(plan) == len(lines) == 4
    assert all("entries a cycle" in line for line in lines)


def test_operators_are_shared_where_runs_come_seldom():
    """14 multiplications and 3 roots: where a run has eight cycles, by one unit for each format of results."""
    found = {config.name: cost(schedule(tile_columns(config), config.point_interval)).operators for config in (TINY, PAPER)}
    assert found["paper"]["FloatMul"] == 14 and found["tiny"]["FloatMul"] == 2
    assert found["paper"]["FloatSqrt"] == 3 and found["tiny"]["FloatSqrt"] == found["tiny"]["FloatReciprocal"] == 1


@pytest.mark.parametrize("support", [None, 0.5, 3.0, 8.0])
def test_a_falloff_limit_fits_its_format_and_the_work_formats_significand(support):
    config = PAPER.with_(support_sigma=support)
    n, number = config.formats, falloff_format(config)
    most = n.log2_opacity.raw_max - tables.log2_alpha_min(n)
    most = min(most, tables.support_exponent(config) or most) + (1 << n.cut.frac_bits - 5)
    assert number.raw_max >= most and number.width <= n.work.sig_bits
    assert most > number.raw_max // 2 or number.int_bits == 0


def test_bad_parameters_are_rejected():
    for unit in (TileTest, TileRuns, LevelTable, TileExpand):
        assert_rejected(lambda unit=unit: unit("paper"), TypeError, "paper")


def test_a_case_of_no_splats_costs_nothing():
    none, levels = np.zeros(0, projected_splat(TINY).dtype), np.zeros((6, 2), np.int64)
    case = Case("", TINY, 40, 20, ((none, levels),))
    assert case.costs()[0] == (0, 0, 0) and tile_test(TINY, none, levels, 40, 20).touched == 0
