"""The setup unit against a model of docs/array.md in Python integers."""

from __future__ import annotations

import random
import sys

import numpy as np
import pytest

from rtl.vrc_array.setup import LATENCY, SetupUnit
from spec.config import FPGA, PAPER_SMALL, NumberFormats
from spec.constants import EXPONENT_SCALE, LOW_PASS
from spec.formats import SQ
from spec.records import array_splat, pixel_op, tile_header
from spec.tables import CENTRE_EXPONENT_MAX, log2_alpha_min, support_exponent
from tests.helpers.rtl_streams import assert_rejected, exchange

N = PAPER_SMALL.formats
LARGEST = EXPONENT_SCALE / LOW_PASS**0.5
BACKGROUND = (3, 300, 511)


def rs(x: int, n: int) -> int:
    return (x + (1 << n >> 1)) >> n


def polynomial(entry: dict, tile_x: int, tile_y: int) -> dict | None:
    """Steps 1-6: the op's terms with `exponent` the corner's, or None where the pair is dropped."""
    fm, fo, fk, g, p = N.mean2d.frac_bits, N.offset.frac_bits, N.factor.frac_bits, N.exponent.frac_bits, N.conic.sig_bits
    d = [((16 * tile + 8) << fm) + (1 << fm - 1) - mean for tile, mean in zip((tile_x, tile_y), entry["mean2d"], strict=True)]
    conic = [tuple(int(x) for x in N.conic.fields(bits)) for bits in entry["conic"]]

    def offset(factor: tuple[int, int], distance: int) -> int:
        shift = p - 1 - factor[1] + fm - fo
        return rs(factor[0] * distance, shift) if shift < 48 else 0

    u, v = offset(conic[0], d[0]) + offset(conic[1], d[1]), offset(conic[2], d[1])
    if not all(N.offset.raw_min <= x <= N.offset.raw_max for x in (u, v)) or u * u + v * v >= CENTRE_EXPONENT_MAX << 2 * fo:
        return None
    k1, k2, k3 = (rs(m, -e) if -e <= p else 0 for m, e in conic)
    xx, xy, yy = (-rs(2 * k, 2 * fk - g) for k in (k1 * k1, k1 * k2, k2 * k2 + k3 * k3))
    gx = -rs(2 * u * k1, fo + fk - g) + (xx >> 1)
    gy = -rs(2 * (u * k2 + v * k3), fo + fk - g) + (yy >> 1)
    corner = -rs(u * u + v * v, 2 * fo - g) - 8 * gx - 8 * gy + 36 * xx + 36 * yy + 64 * xy
    return {"exponent": corner, "slope_x": gx - 8 * xx - 8 * xy, "slope_y": gy - 8 * yy - 8 * xy,
            "curve_xx": xx, "curve_xy": xy, "curve_yy": yy}


def ops_of(config, header: dict, entries: list[dict]) -> list[dict]:
    """All ops of a tile."""
    blend, support, g = header["blend"] and config.levels > 1, support_exponent(config), N.exponent.frac_bits
    ops, started = [], set()

    def give(bank: int, **fields) -> None:
        ops.append({"bank": bank, "first": bank not in started, "last": 0, "drain": 0, **fields})
        started.add(bank)

    for entry in entries:
        terms = polynomial(entry, header["tile_x"], header["tile_y"])
        for bank in range(2 if blend else 1):
            if not entry["use"][bank] or terms is None:
                continue
            opacity = entry["log2_opacity"][bank]
            cut = log2_alpha_min(N) if support is None else max(opacity - support, log2_alpha_min(N))
            exponent = terms["exponent"] + (opacity << g - N.log2_opacity.frac_bits) + (1 << g - N.cut.frac_bits - 1)
            give(bank, **{**terms, "exponent": exponent}, cut=cut, colour=entry["colour"][3 * bank : 3 * bank + 3],
                 depth=entry["depth"] if config.depth else 0, outer=header["outer"] or bank)
    nothing = dict.fromkeys(("exponent", "slope_x", "slope_y", "curve_xx", "curve_xy", "curve_yy", "cut", "depth"), 0)
    for bank in range(2 if blend else 1):
        give(bank, **nothing, colour=list(BACKGROUND), outer=1)
        ops[-1] |= {"last": 1, "drain": bank == (1 if blend else 0)}
    return ops


def an_entry(rng: random.Random, header: dict) -> dict:
    """A splat near the tile, sometimes far or degenerate, with an upper Cholesky factor no larger than the low-pass allows."""
    factor = np.array([[rng.uniform(0, 1), rng.uniform(-1, 1)], [0, rng.uniform(0, 1)]]) * 2.0 ** rng.uniform(-9, 1)
    factor *= min(1.0, LARGEST / np.linalg.norm(factor, 2))
    factor *= [[rng.random() > 0.05, rng.random() > 0.1], [1, rng.random() > 0.05]]
    reach = rng.choice((0, 3, 20, 20, 200, 20_000))
    mean = [16 * header[f"tile_{axis}"] + 8.5 + rng.uniform(-reach, reach) for axis in "xy"]
    return {
        "mean2d": N.mean2d.quantise(mean).tolist(),
        "conic": N.conic.quantise(factor[[0, 0, 1], [0, 1, 1]]).tolist(),
        "use": [rng.random() < 0.7, rng.random() < 0.7],
        "log2_opacity": [rng.randint(-16 << N.log2_opacity.frac_bits, 7 << N.log2_opacity.frac_bits) for _ in range(2)],
        "colour": [rng.randint(0, N.colour.raw_max) for _ in range(6)],
        "depth": rng.randint(0, N.depth.raw_max),
    }


def tiles(seed: int, counts: list[int]) -> list[tuple[dict, list[dict]]]:
    rng, work = random.Random(seed), []
    for count in counts:
        header = {"tile_x": rng.choice((0, 5, 511)), "tile_y": rng.choice((0, 31, 511)), "outer": rng.getrandbits(1),
                  "blend": rng.getrandbits(1), "plane": [0, 0, 0], "count": count}
        work.append((header, [an_entry(rng, header) for _ in range(count)]))
    return work


def simulate(config, work, stopped: int = 0, count: int | None = None, **options) -> tuple[list[dict], list[dict], list[int]]:
    """(expected ops, the unit's ops, their cycles)."""
    dut, op = SetupUnit(config), pixel_op(config)
    expected = [each for header, entries in work for each in ops_of(config, header, [] if stopped else entries)]
    sources = {
        dut.tiles: [tile_header(config).pack(header) for header, _ in work],
        dut.entries: [array_splat(config).pack(entry) for _, entries in work for entry in entries],
    }

    def constants(ctx) -> None:
        ctx.set(dut.stopped, stopped)
        ctx.set(dut.background, list(BACKGROUND))

    words, cycles = exchange(dut, sources, dut.ops, len(expected), setup=constants, **options)
    return expected, [op.unpack(word) for word in words], cycles


@pytest.mark.parametrize("pauses", [0.0, 0.4])
def test_ops_are_those_of_the_text(pauses):
    expected, found, _ = simulate(PAPER_SMALL, tiles(1, [0, 30, 1, 0, 0, 2, 60, 200]), pauses=pauses, seed=7)
    assert found == expected
    assert {op["bank"] for op in found} == {0, 1}


@pytest.mark.parametrize("changes", [{"levels": 1}, {"depth": False}, {"support_sigma": None}])
def test_variants(changes):
    expected, found, _ = simulate(PAPER_SMALL.with_(**changes), tiles(2, [40, 0, 20]))
    assert found == expected


def test_short_formats_whose_products_are_not_split(monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "N", FPGA.formats)
    expected, found, _ = simulate(FPGA, tiles(8, [60, 0, 40]))
    assert found == expected


def test_some_pairs_are_dropped_and_most_are_not():
    [(header, entries)] = tiles(3, [300])
    kept = [polynomial(entry, header["tile_x"], header["tile_y"]) is not None for entry in entries]
    assert 0.3 < np.mean(kept) < 0.95


def test_every_op_fits_its_record():
    for header, entries in tiles(4, [200] * 5):
        for op in ops_of(PAPER_SMALL, header, entries):
            pixel_op(PAPER_SMALL).pack(op)


def test_one_op_a_cycle():
    work = tiles(5, [50, 0, 0, 50])
    for header, entries in work:
        header["blend"] = 1
        for entry in entries:
            entry["use"] = [1, 1]
            entry["mean2d"] = N.mean2d.quantise([16 * header[f"tile_{axis}"] + 8 for axis in "xy"]).tolist()
    expected, found, cycles = simulate(PAPER_SMALL, work)
    assert found == expected
    assert cycles == list(range(cycles[0], cycles[0] + len(found)))
    assert cycles[0] in (LATENCY, LATENCY + 1), "the header's cycle, and the entry's as it waits"


def test_stopped_tiles_only_give_their_background():
    work = tiles(6, [20, 3, 40])
    expected, found, _ = simulate(PAPER_SMALL, work, stopped=0b11)
    assert found == expected
    assert all(op["last"] for op in found)


@pytest.mark.parametrize("wrong", [
    {"cut": SQ(3, 9)}, {"factor": SQ(1, 14)}, {"slope": SQ(7, 12)}, {"exponent": SQ(11, 15)}, {"mean2d": SQ(20, 10)},
    {"offset": SQ(5, 25)},
])
def test_formats_that_contradict_the_text_are_rejected(wrong):
    [value] = wrong.values()
    assert_rejected(lambda: SetupUnit(PAPER_SMALL.with_(formats=NumberFormats(**wrong))), ValueError, value)


def test_config_must_be_one():
    assert_rejected(lambda: SetupUnit(3), TypeError, 3)
