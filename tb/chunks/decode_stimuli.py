"""Stimuli of the decode unit: compact records with headers of their own, and the words that the golden decoder gives."""

from __future__ import annotations

from itertools import product

import numpy as np

from golden.host import compact
from spec.chunks import SCALE_TOP_BITS, STEP_BITS, chunk_header, coded_point
from spec.compact import COARSE_BOUND, OPACITY_BITS, POSITION_BITS, compact_geometry, quaternion_bits, scale_bits
from spec.config import AcceleratorConfig
from spec.packing import pack
from spec.records import gaussian_point

_HEADER = ("low", "step", "scale_top", "bound")


def headers(config: AcceleratorConfig, rng: np.random.Generator, count: int, coarse: np.ndarray | bool) -> np.ndarray:
    """(N,) headers of chunks of one, with random grids within each other's reach, sizes and bounds; `coarse` is one or N. Some
    corners are 0, and some have an exponent of which one bit alone is set."""
    out = np.zeros(count, chunk_header(config).dtype)
    position = config.formats.position
    low = rng.normal(0, 1, (count, 3)) * 2.0 ** rng.uniform(-12, 12, (count, 1))
    bit = 1 << rng.integers(0, position.exp_bits, (count, 3))
    alone = np.copysign(2.0 ** (bit - float(position.bias)), low)
    out["low"] = position.quantise(np.choose(rng.choice(3, (count, 3), p=(0.8, 0.1, 0.1)), (low, alone, 0.0)))
    out["step"] = rng.integers(16, 44, (count, 3))
    out["scale_top"] = rng.integers(0, 1 << SCALE_TOP_BITS, count)
    out["bound"] = np.where(coarse, COARSE_BOUND, rng.integers(0, COARSE_BOUND, count))
    out["count"], out["first"] = 1, np.arange(count)
    return out


def records(config: AcceleratorConfig, rng: np.random.Generator, of: np.ndarray) -> np.ndarray:
    """(N,) random geometry for these headers; all codes of a field are equally likely, but for positions of 0."""
    out = np.zeros(len(of), compact_geometry(config, coarse=True).dtype)
    coarse = (of["bound"] == COARSE_BOUND)[:, None]
    out["position"] = rng.integers(0, 1 << POSITION_BITS, (len(of), 3)) * (rng.random((len(of), 3)) < 0.9)
    out["scale"] = rng.integers(0, 1 << np.where(coarse, scale_bits(True), scale_bits(False)), (len(of), 3))
    out["largest"] = rng.integers(0, 4, len(of))
    half = 1 << np.where(coarse, quaternion_bits(True), quaternion_bits(False)) - 1
    out["quaternion"] = rng.integers(-half, half, (len(of), 3))
    out["opacity"] = rng.integers(0, 1 << OPACITY_BITS, len(of))
    return out


def packed(config: AcceleratorConfig, of: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(N, 16) uint8: the records in memory. Their unused bits are set, because a decoder must ignore them."""
    out = np.zeros((len(rows), compact.GEOMETRY_BYTES), np.uint8)
    for coarse in (False, True):
        record, chosen = compact_geometry(config, coarse), (of["bound"] == COARSE_BOUND) == coarse
        out[chosen] = pack(record, rows[chosen], compact.GEOMETRY_BYTES)
        mask = (1 << 8 * compact.GEOMETRY_BYTES) - (1 << record.width)
        out[chosen] |= np.frombuffer(mask.to_bytes(compact.GEOMETRY_BYTES, "little"), np.uint8)
    return out


def points(config: AcceleratorConfig, chunks: np.ndarray, rows: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(N,) GaussianPoint items of the chunks' Gaussians, as the golden decoder has them."""
    out = np.zeros(len(rows), gaussian_point(config).dtype)
    for name, raw in compact.decode_shape(config, chunks, rows).items():
        out[name] = raw
    out["log2_opacity"] = compact.decoded_opacity(rows["opacity"])
    out["bound"], out["index"] = np.repeat(chunks["bound"], chunks["count"]), index
    return out


def items(config: AcceleratorConfig, of: np.ndarray, rows: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(codes, points) of one frame: each Gaussian with its header, and an item with `end` at last, which is all 0 besides."""
    codes = np.zeros(len(rows) + 1, coded_point(config).dtype)
    for name in _HEADER:
        codes[name][:-1] = of[name]
    codes["word"][:-1] = packed(config, of, rows).view("<u4")
    codes["index"][:-1], codes["end"][-1] = index, 1
    ending = np.zeros(1, of.dtype)
    ending["count"] = 1
    wanted = points(config, np.concatenate([of, ending]), np.concatenate([rows, np.zeros(1, rows.dtype)]), codes["index"])
    wanted["end"] = codes["end"]
    return codes, wanted


def random_items(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A frame of random Gaussians, fine and coarse ones mixed."""
    of = headers(config, rng, count, rng.random(count) < 0.5)
    return items(config, of, records(config, rng, of), rng.integers(0, 1 << 24, count))


def every_opacity(config: AcceleratorConfig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """All codes of opacities, in fine records and in coarse ones."""
    codes = np.tile(np.arange(1 << OPACITY_BITS), 2)
    of = headers(config, rng, len(codes), np.arange(len(codes)) >= len(codes) // 2)
    rows = records(config, rng, of)
    rows["opacity"] = codes
    return items(config, of, rows, np.arange(len(codes)))


def every_scale(config: AcceleratorConfig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """All codes of scales on each axis, below the largest scale of a chunk that is any, the smallest and around zero."""
    tops = (0, 15, 16, 17, 31, 200, 513, (1 << SCALE_TOP_BITS) - 1)
    pairs = [(coarse, code, top) for coarse in (False, True) for top in tops for code in range(1 << scale_bits(coarse))]
    coarse, code, top = np.array(pairs).T
    of = headers(config, rng, len(pairs), coarse == 1)
    of["scale_top"] = top
    rows = records(config, rng, of)
    most = (1 << np.where(coarse, scale_bits(True), scale_bits(False))) - 1
    rows["scale"] = np.stack([code, most - code, code ^ 1], 1)
    return items(config, of, rows, np.arange(len(pairs)))


def corner_quaternions(config: AcceleratorConfig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Components of zero, of an ulp, equal ones and the largest that codes allow, for each position of the fourth; and many
    near unit length."""
    found = []
    for coarse in (False, True):
        half = 1 << quaternion_bits(coarse) - 1
        ends = (-half, 1 - half, -half // 2, -1, 0, 1, half // 2, half - 1)
        found += [(coarse, largest, *codes) for largest in range(4) for codes in product(ends, repeat=3)]
        unit = rng.normal(size=(2000, 4)) * rng.choice([0.01, 0.3, 1], (2000, 4))
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        for q in unit:
            largest = int(np.abs(q).argmax())
            others = np.delete(q, largest) * np.sign(q[largest])
            found.append((coarse, largest, *np.clip(np.rint(others * half * np.sqrt(2)), -half, half - 1).astype(int)))
    coarse, largest, *codes = np.array(found).T
    of = headers(config, rng, len(found), coarse == 1)
    rows = records(config, rng, of)
    rows["largest"], rows["quaternion"] = largest, np.stack(codes, 1)
    return items(config, of, rows, np.arange(len(found)))


def corner_positions(config: AcceleratorConfig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Corners of grids from the smallest to the largest numbers: sums that cancel, that are ties, and that saturate."""
    n, most = config.formats.position, (1 << POSITION_BITS) - 1
    codes = (0, 1, 2, 3, 0x7FFF, 0x8000, 0x8001, 0xAAAA, most - 1, most)
    lows = [0.0, n.min, -n.min, n.max, -n.max, 1.0, -1.0, -(2.0**-40) * most, -(2.0**23), 1 + 2.0**-19, -1 - 2.0**-19, 3e5]
    grid = list(product(lows, range(0, 1 << STEP_BITS, 3), codes))
    low, step, code = (np.array(column) for column in zip(*grid, strict=True))
    of = headers(config, rng, len(grid), rng.random(len(grid)) < 0.5)
    rows = records(config, rng, of)
    # Further axes: the first one's opposite with a step of any size, and a sum that is a tie or next to one.
    steps = rng.integers(0, 1 << STEP_BITS, len(grid))
    ulp = 2.0 ** (20 - 40 + steps)
    tie = rng.integers(1 << 19, 1 << 20, len(grid)) * ulp * rng.choice([-1, 1], len(grid))
    of["low"] = n.quantise(np.stack([low, -low, tie], 1))
    of["step"] = np.stack([step, steps, steps], 1)
    near = rng.integers(0, 1 << 16, len(grid)) & ~0x7FFF | rng.integers(-1, 2, len(grid)) & 0x7FFF
    rows["position"] = np.stack([code, rng.choice(codes, len(grid)), near], 1)
    return items(config, of, rows, np.arange(len(grid)))
