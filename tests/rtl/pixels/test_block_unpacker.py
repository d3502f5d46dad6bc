"""The block unpacker in Verilator: rows of whole and of damaged blocks, and faults put there on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Module, Signal
from amaranth.sim import Simulator

from golden.host.packed_frame import block_checks
from rtl.pixels.block_unpacker import BlockUnpacker
from rtl.pixels.check import first_state, next_state
from rtl.units import emit
from spec.config import TINY
from spec.memory import BEAT_BYTES
from spec.packed import BLOCK_BITS, CHECK_BITS, PackedError
from tb.common.exact import problems
from tb.pixels import unpacker_suite
from tests.helpers.rtl_streams import assert_rejected


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """The plan and its outcome."""
    plan = unpacker_suite.unit_plan(TINY, 0)
    return plan, unpacker_suite.run_plan(TINY, plan, tmp_path_factory.mktemp("unpacker"))


def test_every_row_is_right_and_no_cycle_is_lost(played):
    plan, outcome = played
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 7_000
    assert sum(item.most_cycles is not None for item in plan) == 4


def test_every_error_occurs(played):
    plan, _ = played
    found = {item.name: {*item.expected["rows"]["error"].tolist()} for item in plan}
    assert set.union(*(errors for name, errors in found.items() if name.startswith("damaged"))) == {*PackedError}
    assert found["rate, graded"] == {PackedError.NONE} and PackedError.CHECK in found["errors of the memory"]


def test_faults_are_found(played):
    plan, outcome = played
    item = next(item for item in plan if item.name == "damaged 1")
    recording = outcome.recordings[item.name]
    for name in ("pixel", "error"):
        rows = item.expected["rows"].copy()
        rows[name][7] ^= 1
        assert problems(replace(item, expected={"rows": rows}), recording)[0].startswith("rows 7: ")


def test_the_check_is_the_golden_one():
    """As Amaranth's constants: every bit of a beat and of a state, and random ones."""
    m, block, beat, state = Module(), Signal(BLOCK_BITS), Signal(8 * BEAT_BYTES), Signal(CHECK_BITS)
    m.d.comb += state.eq(next_state(first_state(block), beat))
    rng = np.random.default_rng(0)
    beats = [*(1 << n for n in range(8 * BEAT_BYTES)), *(int.from_bytes(rng.bytes(BEAT_BYTES), "little") for _ in range(20))]
    numbers = [0] * len(beats[:100]) + rng.integers(0, 1 << BLOCK_BITS, len(beats) - 100).tolist()
    found = []

    async def process(ctx):
        for number, word in zip(numbers, beats, strict=True):
            ctx.set(block, number)
            ctx.set(beat, word)
            found.append(ctx.get(state))

    simulator = Simulator(m)
    simulator.add_testbench(process)
    simulator.run()
    slots = np.stack([np.frombuffer(word.to_bytes(BEAT_BYTES, "little"), np.uint8) for word in beats])
    assert found == block_checks(slots, np.ones(len(beats), np.int64), np.array(numbers)).tolist()


def test_verilog_and_bad_parameters():
    text = emit("block_unpacker", TINY)
    assert "module block_unpacker(" in text and emit("block_unpacker", TINY) == text
    assert_rejected(lambda: BlockUnpacker("tiny"), TypeError, "tiny")
