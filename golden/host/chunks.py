"""Cuts a model in spatial order into chunks, and makes their headers (`spec.chunks`)."""

from __future__ import annotations

import numpy as np

from golden.kernels import compiled
from spec.chunks import (
    BOX_SHIFT,
    CHUNK,
    SCALE_TOP_BITS,
    SCALE_TOP_STEPS,
    STEP_BITS,
    chunk_header,
)
from spec.compact import OPACITY_BITS, OPACITY_ONE, OPACITY_STEP_LOG2, POSITION_BITS, STEP_BIAS
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.tables import log2_alpha_min

WIDEST = 2.0 ** (POSITION_BITS - 1 + (1 << STEP_BITS) - 1 - STEP_BIAS)
"""World units that the means of a chunk extend along an axis at most. The grid with the largest step is twice as wide, so that
a step can still be widened."""

SIZE_SPAN = 8 * SCALE_TOP_STEPS
"""Most steps, SCALE_TOP_STEPS in an octave, between the largest scales of two splats of a chunk. A compact scale reaches 16
octaves below the chunk's largest, so each splat has 8 octaves and more below its own largest scale."""

FINE_STEPS = 1 << 4
"""Steps of a grid in the smallest of the largest scales of a chunk's splats, at least: no position is more than 1/32 of its
splat's standard deviation off. One far splat beside near ones would coarsen their grid. Where the step is below an ulp of the
chunk's positions, it may be any size."""

_NO_SIZE = -1  # of a splat without any size, which fits every chunk


def sixteenths(config: AcceleratorConfig, scale: np.ndarray) -> np.ndarray:
    """int64: `scale` words (any shape) as logarithms of 1/16 octave, rounded up, as `scale_top` has them; _NO_SIZE for zero.

    Scales above the largest `scale_top` get a number that does not fit the field.
    """
    value = config.formats.scale.to_float(scale)
    mantissa, exponent = np.frexp(value)
    inside = np.ceil(SCALE_TOP_STEPS * np.log2(np.where(value > 0, mantissa, 1.0)))
    steps = (exponent + config.formats.scale.bias) * SCALE_TOP_STEPS + inside
    return np.where(value > 0, steps, _NO_SIZE).astype(np.int64)


def largest_scale(config: AcceleratorConfig) -> float:
    """The largest scale that a header can name; larger ones must be clipped before."""
    return float(2.0 ** (((1 << SCALE_TOP_BITS) - 1) / SCALE_TOP_STEPS - config.formats.scale.bias))


@compiled
def _starts(bound, mean, size, sigma, widest, span, per_sigma, per_place):
    """Where chunks begin: greedily, each takes Gaussians as long as its rules hold."""
    starts, count = np.empty(len(bound), np.int64), 0
    low, high = np.zeros(3), np.zeros(3)
    smallest = largest = -1
    finest = 0.0
    for i in range(len(bound)):
        fits = count > 0 and i - starts[count - 1] < CHUNK and bound[i] == bound[i - 1]
        if fits:
            for k in range(3):
                first, last = min(low[k], mean[i, k]), max(high[k], mean[i, k])
                fine = max(per_sigma * min(finest, sigma[i]), per_place * max(last, -first))
                fits &= last - first <= min(widest, fine)
            if size[i] >= 0 and largest >= 0:
                fits &= max(largest, size[i]) - min(smallest, size[i]) <= span
        if not fits:
            starts[count] = i
            count += 1
            low[:] = mean[i]
            high[:] = mean[i]
            smallest = largest = -1
            finest = sigma[i]
        finest = min(finest, sigma[i])
        for k in range(3):
            low[k] = min(low[k], mean[i, k])
            high[k] = max(high[k], mean[i, k])
        if size[i] >= 0:
            smallest = size[i] if smallest < 0 else min(smallest, size[i])
            largest = max(largest, size[i])
    return starts[:count].copy()


def _above(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """high - low, rounded up where float64 does not hold it."""
    difference = high - low
    back = difference - high
    lost = (high - (difference - back)) - (low + back)  # Knuth's two-sum: exactly what the subtraction lost
    return np.where(lost > 0, np.nextafter(difference, np.inf), difference)


def place(config: AcceleratorConfig, low: np.ndarray, step: np.ndarray, code: np.ndarray) -> np.ndarray:
    """float64: coordinates on grids, rounded to `position` once. Both summands are short enough that rounding their float64 sum
    is rounding their sum."""
    return config.formats.position.round(low + np.ldexp(code.astype(np.float64), step - STEP_BIAS))


def position_codes(low: np.ndarray, step: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """int64: the codes of coordinates on grids, nearest, ties to even."""
    return np.rint(np.ldexp(mean - low, STEP_BIAS - step)).astype(np.int64)


def _grids(config: AcceleratorConfig, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(step, extent), int64, of the finest grids from `low` (any shape) on that hold `high`. Their boxes contain both `high`
    and what its code decodes to."""
    most = (1 << POSITION_BITS) - 1
    size = _above(high, low)
    step = np.where(size > 0, np.frexp(size)[1] - POSITION_BITS + STEP_BIAS, 0)  # this or the next is enough before rounding
    step = np.clip(step, 0, (1 << STEP_BITS) - 1).astype(np.int64)
    while True:
        code = position_codes(low, step, high)
        short = code > most
        if not short.any():  # then `reached` is at most 65,535.5 steps away, within the 256 boxes of 256 steps
            reached = np.maximum(place(config, low, step, code), high)
            cells = np.ceil(np.ldexp(_above(reached, low), STEP_BIAS - BOX_SHIFT - step))
            return step, np.maximum(cells, 1).astype(np.int64) - 1
        if (step[short] == (1 << STEP_BITS) - 1).any():
            raise ValueError(f"a chunk must not be wider than {WIDEST}, not {float(size[short].max())!r}")
        step = step + short


def opacity_code_above(config: AcceleratorConfig, log2_opacity: np.ndarray) -> np.ndarray:
    """int64: the smallest codes not below raw `log2_opacity` (any shape); 0 where nothing can be seen."""
    raw = np.asarray(log2_opacity, np.int64)
    one = 2.0**config.formats.log2_opacity.frac_bits
    linear = np.clip(np.ceil(OPACITY_ONE * np.exp2(np.minimum(raw, 0) / one)), 1, OPACITY_ONE).astype(np.int64)
    above = np.minimum(OPACITY_ONE - (-raw >> OPACITY_STEP_LOG2), (1 << OPACITY_BITS) - 1)
    return np.where(raw < log2_alpha_min(config.formats), 0, np.where(raw > 0, above, linear))


def strongest(config: AcceleratorConfig, geometry: np.ndarray) -> np.ndarray:
    """(N,) raw `log2_opacity`: the largest among the levels that use a Gaussian."""
    used = np.arange(MAX_LEVELS) <= geometry["bound"][:, None]
    return np.where(used, geometry["log2_opacity"], config.formats.log2_opacity.raw_min).max(axis=1)


def cut_chunks(config: AcceleratorConfig, geometry: np.ndarray) -> np.ndarray:
    """(C,) headers, records of `chunk_header`, of a model's chunks, without their opacities.

    A chunk begins where the one before is full, where the bound changes, where the means would not fit a grid (WIDEST) or one
    that is fine enough (FINE_STEPS), and where sizes would span too much (SIZE_SPAN). `opacity` stays 0
    (`golden.host.quantise.with_opacities`), because with compact records it is known only after encoding.

    Args:
        config: the machine.
        geometry: (N,) wide records, in their order in memory; no scale is above `largest_scale`.
    """
    chunks = np.zeros(0, chunk_header(config).dtype)
    if not len(geometry):
        return chunks
    n = config.formats
    mean, bound = n.position.to_float(geometry["mean"]), geometry["bound"].astype(np.int64)
    size, sigma = sixteenths(config, geometry["scale"]).max(axis=1), n.scale.to_float(geometry["scale"]).max(axis=1)
    per_sigma, per_place = 2.0**POSITION_BITS / FINE_STEPS, 2.0 ** (POSITION_BITS - n.position.sig_bits)
    first = _starts(bound, mean, size, sigma, WIDEST, SIZE_SPAN, per_sigma, per_place)
    chunks = np.zeros(len(first), chunk_header(config).dtype)
    low = np.minimum.reduceat(mean, first)
    step, extent = _grids(config, low, np.maximum.reduceat(mean, first))
    chunks["low"], chunks["step"], chunks["extent"] = n.position.quantise(low), step, extent
    chunks["scale_top"] = np.maximum(np.maximum.reduceat(size, first), 0)
    chunks["bound"], chunks["first"] = bound[first], first
    chunks["count"] = np.diff(np.append(first, len(geometry)))
    return chunks


def chunk_of(chunks: np.ndarray) -> np.ndarray:
    """(N,) int64: the chunk of every Gaussian."""
    return np.repeat(np.arange(len(chunks)), chunks["count"])
