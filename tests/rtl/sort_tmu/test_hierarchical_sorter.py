"""The hierarchical sorter: the merge tree alone, and the whole with a memory against the golden order."""

from __future__ import annotations

import random
import re
from dataclasses import replace

import pytest
from amaranth.lib import data

from rtl.emit import to_rtlil
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.merge_tree import MergeTree, run_layout
from rtl.sort_tmu.run_reader import RunReader
from rtl.sort_tmu.run_writer import RunWriter
from spec.config import PAPER_SMALL, TINY
from spec.records import intersection
from tb.common.exact import problems
from tb.sort_tmu import hierarchical_suite as suite
from tests.helpers.rtl_streams import assert_rejected, exchange


def run_items(shape: data.StructLayout, runs: list[list[int]]) -> list[int]:
    """Runs as a leaf takes them; an empty one is a blank."""
    return [
        shape.const({"word": word, "last": place == max(len(run), 1), "blank": not run}).as_bits()
        for run in runs for place, word in enumerate(run or [0], 1)]


@pytest.mark.parametrize("pauses", [0, 0.5])
@pytest.mark.parametrize("ways", [2, 4, 8])
def test_a_tree_merges_runs_and_skips_blanks(ways, pauses):
    rng, dut, shape = random.Random(ways), MergeTree(4, ways), run_layout(4)
    merges = [
        [sorted(rng.randrange(16) for _ in range(rng.choice([0, 0, 1, 2, 7]))) for _ in range(ways)] for _ in range(60)]
    merges[7] = [[] for _ in range(ways)]
    expected = run_items(shape, [sorted(word for run in merge for word in run) for merge in merges])
    sources = {dut.sinks[i]: run_items(shape, [merge[i] for merge in merges]) for i in range(ways)}
    got, _ = exchange(dut, sources, dut.source, len(expected), pauses=pauses)
    for bits, wanted in zip(got, expected, strict=True):
        item, right = shape.from_bits(bits), shape.from_bits(wanted)
        assert (item.last, item.blank) == (right.last, right.blank)
        assert item.word == right.word or item.blank


def test_a_tree_loses_no_cycle_between_merges_without_blanks():
    dut, shape = MergeTree(8, 4), run_layout(8)
    runs = [[i, i + 40, i + 80] for i in range(10)]
    items = run_items(shape, runs)
    _, cycles = exchange(dut, dict.fromkeys(dut.sinks, items), dut.source, 120)
    assert cycles == list(range(cycles[0], cycles[0] + 120)) and cycles[0] <= 4


@pytest.fixture(scope="module", params=[suite.SMALL, suite.WIDE], ids=lambda config: config.name)
def small(request, tmp_path_factory):
    """Plan and outcome of machines with short chunks, whose merges take several rounds."""
    config = request.param
    plan = [*suite.directed_plan(config, 0), *suite.memory_plan(config, 0), *suite.rate_plan(config, 0)]
    return plan, suite.run_plan(config, plan, tmp_path_factory.mktemp(config.name))


def test_short_chunks_are_exact(small):
    plan, outcome = small
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 10_000


def test_short_chunks_meet_what_they_are_for(small):
    """Regions that do not suffice, and merges that go back to memory."""
    plan, outcome = small
    largest = max(int(name.split()[3]) for name in (item.name for item in plan) if name.startswith("a region"))
    by_name = {item.name: outcome.recordings[item.name] for item in plan if item.run.abort is None}
    assert by_name["a region of 1 runs and 0 beats"].observed["overflow"] == 1
    assert by_name[f"a region of {largest} runs and 0 beats"].observed["overflow"] == 0
    lengths = by_name["lengths about the capacity and its multiples"]
    assert lengths.observed["spilled"] > 1.2 * lengths.items["groups"]


def test_faults_are_found(small):
    plan, outcome = small
    item = next(item for item in plan if item.name == "small between large")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for name in item.expected["sorted"].dtype.names:
        rows = item.expected["sorted"].copy()
        rows[name][3] ^= 1
        wrong = problems(replace(item, expected={"sorted": rows}), recording)
        assert len(wrong) == 1 and wrong[0].startswith("sorted 3: ")
    spilled = item.observed["spilled"]
    assert problems(replace(item, observed={"spilled": spilled + 1}), recording) == [f"spilled is {spilled}, not {spilled + 1}"]


def test_tiny_is_exact_and_fast_enough(tmp_path):
    plan = [*suite.directed_plan(TINY, 1), *suite.rate_plan(TINY, 1)]
    outcome = suite.run_plan(TINY, plan, tmp_path)
    assert outcome.failures == {}
    lines = suite.figures(TINY, plan, outcome)
    assert len(lines) == 1 + len(suite.ORDERS) and all("1.0000 entries a cycle taken" in line for line in lines)


@pytest.mark.long
@pytest.mark.parametrize("config", [suite.SMALL, suite.WIDE, TINY, PAPER_SMALL], ids=lambda config: config.name)
def test_everything_is_exact(config, tmp_path):
    """Scenes' groups too; the embedded scene always, trained ones where they are."""
    plan = suite.full_plan(config, 2)
    outcome = suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {}


@pytest.mark.parametrize("config", [TINY, PAPER_SMALL], ids=lambda config: config.name)
def test_storage_is_what_the_text_says(config):
    def bits(component) -> int:
        memories = re.findall(r"memory width (\d+) size (\d+)", to_rtlil(component, "unit"))
        return sum(int(width) * int(depth) for width, depth in memories)

    own = bits(HierarchicalSorter(config)) - bits(ChunkSorter(config))
    ahead, queue = config.merge_ways * 32 * 260, 31 * (256 + 27 + 3)
    order = (config.merge_ways * 32 - 1) * (4 + config.merge_ways.bit_length() - 1)
    assert 0 < own - ahead - queue - order < 3000  # the rest: queues of cuts, parts and merges


def test_bad_parameters_are_rejected():
    for ways, error in ((3, ValueError), (1, ValueError), (True, TypeError), ("4", TypeError)):
        assert_rejected(lambda ways=ways: MergeTree(8, ways), error, ways)
    for make in (lambda n: RunReader(TINY, way_beats=n), lambda n: RunWriter(TINY, depth=n)):
        for value, error in ((1, ValueError), (2.0, TypeError)):
            assert_rejected(lambda make=make, value=value: make(value), error, value)
    assert_rejected(lambda: HierarchicalSorter("paper"), TypeError, "paper")


def test_written_counts_by_hand():
    """Nine runs and four ways: seven of them are moved once, as MergePlan's picture shows."""
    top = 256
    assert suite.written(TINY, top + 1) == top + 1
    assert suite.written(TINY, 4 * top) == 4 * top
    assert suite.written(TINY, 9 * top) == (9 + 4 + 3) * top
    assert intersection(TINY).width <= 64
