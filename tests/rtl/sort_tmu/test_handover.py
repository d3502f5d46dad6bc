"""The buffers between sorting unit and array: every item through, and none shown before its group is complete."""

from __future__ import annotations

import re

import pytest

from rtl.emit import to_rtlil
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer, handover
from spec.config import PAPER, PAPER_SMALL, TINY
from spec.records import chunk_item
from tb.sort_tmu import handover_suite
from tests.helpers.rtl_streams import assert_rejected, exchange

SMALL = TINY.with_(sort_buffer_bytes=256)  # halves of 16
RECORD = chunk_item(SMALL)


def words(lengths: list[int]) -> list[int]:
    """Groups of these lengths."""
    return [
        RECORD.pack({"tile": group, "depth_key": place, "index": place, "last": place == length - 1, "empty": 0})
        for group, length in enumerate(lengths) for place in range(length)]


@pytest.mark.parametrize("name", handover_suite.DISTINCT)
def test_tiny_passes_everything_in_as_many_cycles_as_it_must(name, tmp_path):
    config = handover_suite.VARIANTS[name]
    plan = handover_suite.unit_plan(config, 0)
    outcome = handover_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 20_000
    timed = [item for item in plan if item.most_cycles is not None]
    assert [outcome.recordings[item.name].cycles for item in timed] == [item.most_cycles for item in timed]


@pytest.mark.long
@pytest.mark.parametrize("name", ["paper_small", "paper_small-double"])
def test_default_passes_everything(name, tmp_path):
    config = handover_suite.VARIANTS[name]
    assert handover_suite.run_plan(config, handover_suite.full_plan(config, 1), tmp_path).failures == {}


def test_a_double_buffer_shows_complete_groups_only():
    """First items of groups leave two cycles behind the group's last, or behind the group before."""
    lengths = [2, 3, 9, 16]
    items = words(lengths)
    dut = DoubleBuffer(SMALL)
    got, cycles = exchange(dut, {dut.sink: items}, dut.source, len(items))
    assert got == items
    assert [cycles[place] for place in (0, 2)] == [3, 6]  # taken in cycles 0, 1 and 2, 3, 4
    for first, length in ((5, 9), (14, 16)):
        assert cycles[first + length - 1] - cycles[first] == length - 1
    dut = LineBuffer(SMALL)
    assert exchange(dut, {dut.sink: items}, dut.source, len(items)) == (items, list(range(2, len(items) + 2)))


def test_a_double_buffer_cuts_what_is_larger_than_a_half():
    items = words([40])
    dut = DoubleBuffer(SMALL)
    got, cycles = exchange(dut, {dut.sink: items}, dut.source, 40)
    assert got == items and cycles[0] == 17 and cycles[16] == 33


def test_the_config_decides():
    units = [handover(TINY), handover(TINY.with_(incremental=False))]
    assert isinstance(units[0], LineBuffer) and isinstance(units[1], DoubleBuffer)
    assert units[0].signature == units[1].signature
    for unit in units:  # a component that nobody elaborates complains
        assert to_rtlil(unit, "handover")
    assert_rejected(lambda: handover("paper"), TypeError, "paper")


@pytest.mark.parametrize(("config", "entries"), [
    (TINY, 127), (PAPER_SMALL, 127), (TINY.with_(incremental=False), 512), (PAPER.with_(incremental=False), 8192)])
def test_sizes(config, entries):
    """Of the line buffer one entry is in the memory's output register."""
    width, depth = re.search(r"memory width (\d+) size (\d+)", to_rtlil(handover(config), "handover")).groups()
    assert (int(width), int(depth)) == (chunk_item(config).width, entries)
