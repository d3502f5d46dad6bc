"""The pixel writer in Verilator: every suite's runs, what memory then holds, and faults put there on purpose.

The other machines and the trained scenes are long.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from rtl.units import emit
from rtl.vrc_array.pixel_writer import PixelWriter
from spec.config import TINY
from spec.memory import BEAT_BITS, WORDS, display_pixel, frame_pixel, write_request
from spec.packing import unpack
from spec.records import pixel_row
from tb.common.exact import problems
from tb.vrc_array import pixel_writer_suite
from tb.vrc_array.pixel_writer_stimuli import memory_of, random_pixels, rows_of, writes_of
from tests.helpers.rtl_streams import assert_rejected, exchange


def quick_plan(config):
    return [*pixel_writer_suite.unit_plan(config, 0), *pixel_writer_suite.rate_plan(config, 0)]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """TINY's plan and outcome."""
    plan = quick_plan(TINY)
    return plan, pixel_writer_suite.run_plan(TINY, plan, tmp_path_factory.mktemp("writer"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 20_000


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "33 x 20")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for name in write_request(TINY).dtype.names:
        rows = item.expected["writes"].copy()
        rows[name][3] ^= 1
        assert problems(replace(item, expected={"writes": rows}), recording)[0].startswith("writes 3: ")
    for name in item.observed:
        assert problems(replace(item, observed={name: item.observed[name] + 1}), recording)


def in_bytes(value, fraction_bits):
    """A value in 255ths, half up."""
    return math.floor(Fraction(255 * int(value), 1 << fraction_bits) + Fraction(1, 2))


@pytest.mark.parametrize("display", [False, True], ids=["whole", "display"])
@pytest.mark.parametrize(("width", "height"), pixel_writer_suite.SIZES)
def test_memory_has_every_pixel_once_and_nothing_else(tiny, width, height, display):
    plan, outcome = tiny
    name = f"{width} x {height}" + pixel_writer_suite.FORMATS[display]
    item = next(item for item in plan if item.name == name)
    base, rows = item.run.settings["frame_base"], item.run.inputs["rows"]
    record = (display_pixel if display else frame_pixel)(TINY)
    words, times = memory_of(outcome.recordings[name].outputs["writes"], base, width * height * record.width // 32)
    assert (times == 1).all()
    got, n = unpack(record, words.astype("<u4").view(np.uint8).reshape(width * height, -1)), TINY.formats
    for row in rows:
        y, x = row["tile_y"] * 16 + row["row"], row["tile_x"] * 16 + row["column"]
        for lane in range(TINY.cores_x):
            if y < height and x + lane < width:
                pixel, colour = got[int(y) * width + int(x) + lane], row["colour"][3 * lane : 3 * lane + 3].tolist()
                if display:
                    assert pixel["colour"].tolist() == [min(255, in_bytes(c, n.accumulator.frac_bits)) for c in colour]
                    assert pixel["coverage"] == 255 - in_bytes(row["transmittance"][lane], n.transmittance.frac_bits)
                else:
                    assert pixel["colour"].tolist() == colour
                    assert (pixel["depth"], pixel["transmittance"]) == (row["depth"][lane], row["transmittance"][lane])


def test_words_written_elsewhere_are_told():
    writes = np.zeros(2, write_request(TINY).dtype)
    writes["beat"], writes["strobe"] = (0, 1), (1 << WORDS - 1, 1)
    words, times = memory_of(writes, (1 << BEAT_BITS) - 1, 2 * WORDS + 1)
    assert times.nonzero()[0].tolist() == [2 * WORDS - 1, 2 * WORDS] and not words.any()
    with pytest.raises(ValueError, match=f"in the frame's {2 * WORDS}, not at {2 * WORDS}"):
        memory_of(writes, (1 << BEAT_BITS) - 1, 2 * WORDS)


@pytest.mark.parametrize("display", [False, True], ids=["whole", "display"])
def test_latency_and_a_row_a_cycle(display):
    """Rows of a beat follow each other without a gap; the first beat comes two cycles after its row."""
    config, dut = TINY.with_(cores_x=2), PixelWriter(TINY.with_(cores_x=2))
    rng = np.random.default_rng(0)
    frame = random_pixels(config, rng, 32, 16)
    rows = rows_of(config, frame, rng)
    writes = writes_of(config, frame, rows, 5, display)

    def setup(ctx):
        for port, value in ((dut.width, 32), (dut.height, 16), (dut.display, display), (dut.frame_base, 5)):
            ctx.set(port, value)

    got, cycles = exchange(
        dut, {dut.rows: [pixel_row(config).pack(row) for row in rows]}, dut.writes, len(writes), setup=setup)
    assert got == [write_request(config).pack(row) for row in writes]
    assert cycles == list(range(cycles[0], cycles[0] + len(rows))) and cycles[0] <= 3


def test_verilog():
    text = emit("pixel_writer", TINY)
    assert "module pixel_writer(" in text and emit("pixel_writer", TINY) == text


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: PixelWriter("tiny"), TypeError, "tiny")


def test_traced_frames_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = pixel_writer_suite.traced_plan(TINY, "53x41")
    assert len(plan) == 4 and pixel_writer_suite.run_plan(TINY, plan, tmp_path / "run").failures == {}


@pytest.mark.long
@pytest.mark.parametrize("name", pixel_writer_suite.DISTINCT)
def test_scenes_and_other_machines_are_exact(name, tmp_path):
    """The embedded scene always, trained ones where they are."""
    config = pixel_writer_suite.VARIANTS[name]
    plan = pixel_writer_suite.full_plan(config, 1)
    outcome = pixel_writer_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(pixel_writer_suite.figures(config, plan, outcome)) >= 5
