"""The reader of chunks and the decode unit in Verilator against the golden decoder; the reader of headers in Amaranth's
simulator."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref.supertiles import chunk_order
from rtl.chunks.chunk_reader import ChunkReader
from rtl.chunks.geometry_decode import GeometryDecode
from rtl.chunks.header_reader import ChunkHeaderReader
from spec.chunks import chunk_header, header_item
from spec.config import PAPER, TINY_V3, V3_RECORDS, AcceleratorConfig, NumberFormats
from spec.formats import SQ, SmallFloat
from spec.records import gaussian_geometry
from tb.chunks import decode_suite, reader_suite
from tb.common.exact import problems
from tests.helpers.rtl_ports import beats_of, cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

N = V3_RECORDS.formats


@pytest.fixture(scope="module")
def decoded(tmp_path_factory):
    """The plan of the decode unit and its outcome."""
    plan = decode_suite.full_plan(V3_RECORDS, 0)
    return plan, decode_suite.run_plan(V3_RECORDS, plan, tmp_path_factory.mktemp("decode"))


@pytest.mark.parametrize("variant", reader_suite.DISTINCT)
def test_points_of_chunks_come_one_a_cycle(variant: str, tmp_path_factory):
    config = reader_suite.VARIANTS[variant]
    plan = reader_suite.full_plan(config, 0)
    outcome = reader_suite.run_plan(config, plan, tmp_path_factory.mktemp(variant))
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 40_000
    assert len(reader_suite.figures(config, plan, outcome)) == 5


def test_every_code_is_decoded_as_the_golden_decoder_does(decoded):
    plan, outcome = decoded
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 40_000


def test_the_codes_meet_every_limit(decoded):
    """Stimuli that met none of them would prove nothing."""
    points = np.concatenate([item.expected["points"] for item in decoded[0]])
    assert {N.log2_opacity.raw_min, 0, 8192} <= set(points["log2_opacity"].tolist())
    assert (points["quat"].max(axis=1) == 8191).any() and (points["quat"].max(axis=1) < 4100).any()
    assert (points["scale"] == 0).any() and (points["scale"] >> 11 == 63).any()
    largest = (1 << N.position.width - 1) - 1
    assert (points["mean"] & largest == largest).any() and (points["mean"] == 0).any()


def test_faults_are_found(decoded):
    plan, outcome = decoded
    item = next(item for item in plan if item.name == "random codes")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for name in ("mean", "scale", "quat", "log2_opacity", "bound", "index"):
        wrong = recording.outputs["points"].copy()
        wrong[name][17] ^= 1
        assert problems(item, replace(recording, outputs={"points": wrong})), name


@pytest.mark.parametrize("config", [V3_RECORDS, TINY_V3], ids=lambda config: config.name)
@pytest.mark.parametrize("late", [0, 60])
@pytest.mark.parametrize("pauses", [0.0, 0.4])
def test_headers_come_in_order_and_those_with_an_error_are_left_out(late: int, pauses: float, config: AcceleratorConfig):
    rng, header, item = random.Random(late), chunk_header(config), header_item(config)
    rows = [rng.getrandbits(header.width) for _ in range(40)]
    order = chunk_order(40).tolist() if config.supertiles else list(range(40))
    numbered = [row | i << header.width if config.supertiles else row for i, row in zip(order, rows, strict=True)]
    dut, states = ChunkHeaderReader(config), []

    def each(ctx, cycle):
        ctx.set(dut.start, cycle in (3, 250 + late))
        states.append((ctx.get(dut.busy), ctx.get(dut.error)))

    moves = play(dut, {"data": [*beats_of(rows, 1, (7,)), *beats_of(rows, 1)]}, {"reads": pauses, "headers": pauses},
                 600 + late, setup={"chunks_base": 77, "chunks": 40}, each=each, late=late, pauses=pauses, seed=late)
    end = item.pack({**item.unpack(0), "end": 1})
    assert words_of(moves, "headers") == [*numbered[:7], *numbered[8:], end, *numbered, end]
    assert words_of(moves, "reads") == [77 + i for i in order] * 2
    assert states[249 + late] == (0, 1) and states[3] == (0, 0) and states[-1] == (0, 0) and states[10] == (1, 0)
    if not pauses:
        cycles = cycles_of(moves, "headers")
        assert cycles[39] - cycles[0] == 40 and cycles[-1] - cycles[40] == 40


@pytest.mark.parametrize("count", [1, 3, 4, 5, 29, 31, 32, 33, 37, 64, 79])
def test_every_number_of_chunks_is_walked_through(count: int):
    dut, header = ChunkHeaderReader(TINY_V3), chunk_header(TINY_V3)
    moves = play(dut, {"data": beats_of([0] * count, 1)}, {"reads": 0.0, "headers": 0.0}, 120,
                 setup={"chunks_base": 5, "chunks": count}, each=lambda ctx, cycle: ctx.set(dut.start, cycle == 3))
    order = chunk_order(count).tolist()
    assert sorted(order) == list(range(count))
    assert words_of(moves, "reads") == [5 + i for i in order]
    assert [word >> header.width for word in words_of(moves, "headers")[:-1]] == order


@pytest.mark.parametrize("config", [V3_RECORDS, TINY_V3], ids=lambda config: config.name)
def test_no_chunks_give_only_an_end(config: AcceleratorConfig):
    dut, item = ChunkHeaderReader(config), header_item(config)
    moves = play(dut, {"data": []}, {"reads": 0.0, "headers": 0.0}, 30, setup={"chunks_base": 77, "chunks": 0},
                 each=lambda ctx, cycle: ctx.set(dut.start, cycle == 2))
    assert words_of(moves, "headers") == [item.pack({**item.unpack(0), "end": 1})] and not moves["reads"]


def test_bad_parameters_are_refused():
    for unit in (ChunkReader, ChunkHeaderReader, GeometryDecode):
        assert_rejected(lambda unit=unit: unit("v3"), TypeError, "v3")
    assert_rejected(lambda: GeometryDecode(PAPER), ValueError, "wide")
    long = NumberFormats(position=SmallFloat(20, 10, 127), quaternion=SQ(0, 16))
    width = gaussian_geometry(V3_RECORDS.with_(formats=long)).width
    assert_rejected(lambda: ChunkReader(V3_RECORDS.with_(formats=long, records="wide")), ValueError, width)
    with pytest.raises(ValueError, match=r"quaternion must be SQ0\.13 with compact records, not SQ0\.16"):
        ChunkReader(V3_RECORDS.with_(formats=long))
