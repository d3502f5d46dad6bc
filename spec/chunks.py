"""Chunks of a model: up to 64 Gaussians with a header of one beat, and the test by which the machine skips a whole chunk.

Chunk c holds the Gaussians `first` .. `first + count - 1`, all of the same quality bound. Chunks follow each other without a
gap between their indices. The headers lie in the region `chunks`, one beat each, in order.

**The box.** It reaches from `low` to `low` + (`extent` + 1) * 2^(`step` + BOX_SHIFT - STEP_BIAS) along each axis, and contains
the mean of every Gaussian of the chunk as its words have it.

**The chunk test** never skips a chunk with a splat that has an intersection. Every number below is a small float: `o` has
format `view`, all others format `chunk` of `spec.config`, and every operation rounds to the format of its result, HALF_EVEN. A
sum of three is (a + b) + c. cut(x) is x of format `view` in format `chunk`, rounded towards zero: both have the same exponents.
The settings `rotation`, `near` and `reach` below are cut. i is an axis of the world, k one of the camera::

    h[i] = (extent[i] + 1) * 2^(step[i] + BOX_SHIFT - STEP_BIAS - 1)      half of the box; exact
    w[i] = (extent[i] + 2) * 2^(step[i] + BOX_SHIFT - STEP_BIAS - 1)      the same, widened; exact
    o[i] = low[i] - position[i]
    a[i] = cut(o[i]) + h[i]                                               the box's centre relative to the camera
    g[i] = w[i] + |a[i]| * 2^-CENTRE_MARGIN                               the product is exact, but below 2^-126 it is 0
    v[k] = rotation[k][0] * a[0] + rotation[k][1] * a[1] + rotation[k][2] * a[2]
    s[k] = |rotation[k][0]| * g[0] + |rotation[k][1]| * g[1] + |rotation[k][2]| * g[2]
    lo[k] = v[k] - s[k],  hi[k] = v[k] + s[k]

The rows x and y of `rotation` contain the focal lengths. Rows and numbers with k = z are depths. The chunk is *behind* where
hi[z] <= near. Otherwise::

    q0 = 1 / max(lo[z], near)
    q1 = 1 / hi[z]
    sigma = largest standard deviation of the chunk, see `sigma_significands`
    spread[k] = reach[k] * (sigma * q0)                                           for k = x, y
    left[k]  = lo[k] * (q1 if lo[k] >= 0 else q0) - spread[k]
    right[k] = hi[k] * (q0 if hi[k] >= 0 else q1) + spread[k]

`reach` is a setting: by how many pixels a splat with a standard deviation of 1 at z = 1 reaches at most, where the Jacobian is
clamped (FRUSTUM_MARGIN), times 1 + REACH_MARGIN. Integers follow; floor(x) saturates to PIXEL_BITS bits and a sign::

    first[k] = (floor(left[k]) + (centre[k] >> frac_bits) - PAD) >> 4
    last[k] = (floor(right[k]) + (centre[k] >> frac_bits) + PAD + 2) >> 4

These are the first and the last column (row) of tiles that the chunk's splats can touch. Where spread[k] >= WIDE_SPREAD,
every column (row) is between them, whatever the numbers are. The chunk is *outside* where last < 0 or first is beyond the
frame's last tile. Otherwise both are clamped to the frame.

For each quality bound b, the machine keeps the *level bounds* of the frame: the smallest and the largest x, y, x + y and x - y
of all tiles (x, y) that are rendered and whose level is at most b. The chunk is *filtered* where no tile is in the octagon of
its own bound b that also lies in its box: no such tile exists, or first[x] > x_most, last[x] < x_least, the same for y,
first[x] + first[y] > sum_most, last[x] + last[y] < sum_least, first[x] - last[y] > difference_most, or
last[x] - first[y] < difference_least.

The chunk is *faint* where its opacity's code is 0, *empty* where its count is 0, and *astray* where its count is above CHUNK or
`first` + `count` is above the model's number of Gaussians: whatever lies in memory, nothing is read outside the model. A chunk
that is behind, outside, filtered, faint, empty or astray is skipped; one counter counts all of them.

**Why no survivor is lost.** In units of 2^-14, half an ulp of `chunk`: v differs by at most 8 of the sum of |rotation| * |a|
from what it is for the centre, because cutting `rotation` and `o` costs 2 each, and four more roundings 1 each; lo and hi are
rounded once more. CENTRE_MARGIN adds 16, so 7 are left for the quotient, the product and the difference behind them. s is too
small by at most 6 of itself, and w is larger than h by 64 and more, because an extent has 8 bits. Cut, `near` only becomes
smaller, and REACH_MARGIN covers what cutting and rounding take from `spread`. Where sums saturate, they do so for each of the
chunk's splats, too. A splat whose mean lies beyond the guard band is culled (`spec.guard_band`), and the test may read its
chunk in vain. PAD covers the low-pass filter and the tile test's margins, and the 2 the two floors on the right.
tests/golden/msv2_ref/test_chunk_test.py tries it on random models and cameras.
"""

from __future__ import annotations

import math

from spec.compact import OPACITY_BITS
from spec.config import AcceleratorConfig
from spec.constants import LOG2E_HALF, LOW_PASS, TILE_EDGE_MARGIN, TILE_REACH_MARGIN
from spec.formats import SQ, Fixed
from spec.records import INDEX_BITS, Field, Record, uint

CHUNK = 64
"""Gaussians of a full chunk."""

PLACE_BITS = (CHUNK - 1).bit_length()
"""Bits of a Gaussian's place in its chunk."""

BOX_SHIFT = 8
"""log2 of the steps of a chunk's grid in one step of its extent."""

STEP_BITS = 6
"""Bits of a grid's step."""

EXTENT_BITS = 8
"""Bits of an extent."""

SCALE_TOP_BITS = 10
"""Bits of a chunk's largest scale."""

SCALE_TOP_STEPS = 16
"""Steps of a chunk's largest scale in an octave: it is 2^(scale_top / SCALE_TOP_STEPS - bias of `scale`)."""

COUNT_BITS = 7
"""Bits of the number of Gaussians of a chunk."""

CENTRE_MARGIN = 10
"""-log2 of the share of a box's distance by which the box is widened."""

REACH_MARGIN = 2.0**-6
"""Share by which `reach` is larger than needed: quaternions are not exactly normalised, and boxes of footprints are widened."""

WIDEST_SIGMA = 4.6
"""Standard deviations at which the largest amplified opacity falls below 1/255, where no support ends a splat before."""

WIDE_SPREAD = 1 << 13
"""Pixels of `spread` from which on a chunk can touch all columns (rows)."""

PIXEL_BITS = 15
"""Bits of the pixel coordinates of the chunk test, besides the sign."""

TESTED_CHUNKS = 8
"""Chunks that wait, tested, to be read. While they are read, 64 chunks can be tested and skipped."""

TEST_INTERVAL = 8
"""Cycles between two chunks that enter the chunk test."""


def chunk_header(config: AcceleratorConfig) -> Record:
    """What the machine must know of a chunk before it reads it, one beat."""
    return Record("ChunkHeader", chunk_header.__doc__, (
        Field("low", config.formats.position, "smallest coordinates of the means", 3),
        Field("step", uint(STEP_BITS), "step of the grid along each axis: 2^(step - 40) world units", 3),
        Field("extent", uint(EXTENT_BITS), "size of the box along each axis, less 1, in 256 steps", 3),
        Field("scale_top", uint(SCALE_TOP_BITS), "the largest standard deviation, rounded up, in 1/16 octave"),
        Field("opacity", uint(OPACITY_BITS), "code of the strongest opacity (`spec.compact`), not less than it"),
        Field("bound", uint(2), "quality bound m - 1 of all Gaussians of the chunk"),
        Field("count", uint(COUNT_BITS), "number of Gaussians, 1..64"),
        Field("first", uint(INDEX_BITS), "index of the first Gaussian"),
    ))


def header_item(config: AcceleratorConfig) -> Record:
    """A chunk's header on its way to the chunk test and from there to the reader of Gaussians. A frame ends with an item with
    `end`, which is no chunk."""
    return Record("HeaderItem", header_item.__doc__, (
        *chunk_header(config).fields,
        *([Field("number", uint(INDEX_BITS - PLACE_BITS), "number of the chunk")] if config.supertiles else []),
        Field("end", uint(1), "all chunks of the frame have come; the rest means nothing"),
    ))


def coded_point(config: AcceleratorConfig) -> Record:
    """A Gaussian's compact geometry on its way to the decoder, with what its chunk's header says of it."""
    fields = {f.name: f for f in chunk_header(config).fields}
    return Record("CodedPoint", coded_point.__doc__, (
        *(fields[name] for name in ("low", "step", "scale_top", "bound")),
        Field("word", uint(32), "CompactGeometry", 4),
        Field("index", uint(INDEX_BITS), "Gaussian index"),
        Field("end", uint(1), "all Gaussians of the frame have come; the rest means nothing"),
    ))


def pixel_format() -> Fixed:
    """The format to which the chunk test's pixel coordinates are floored."""
    return SQ(PIXEL_BITS, 0)


def sigma_significands(config: AcceleratorConfig) -> tuple[int, ...]:
    """Significands of the format `chunk` by the lowest bits of `scale_top`: 2^(i / SCALE_TOP_STEPS), rounded up. The exponent
    is that of the bits above, less the bias of `scale`. The last one is the largest significand, so that the largest
    `scale_top` covers every number of the format `scale`."""
    bits = config.formats.chunk.sig_bits
    steps = (math.ceil((1 << bits - 1) * 2 ** (i / SCALE_TOP_STEPS)) for i in range(SCALE_TOP_STEPS - 1))
    return (*steps, (1 << bits) - 1)


def support(config: AcceleratorConfig) -> float:
    """Standard deviations at which a splat of any opacity ends, the tile test's margin included."""
    return math.hypot(min(config.support_sigma or WIDEST_SIGMA, WIDEST_SIGMA), math.sqrt(TILE_REACH_MARGIN / LOG2E_HALF))


def pad(config: AcceleratorConfig) -> int:
    """PAD, the pixels by which a chunk's interval is widened."""
    return math.ceil(support(config) * math.sqrt(LOW_PASS) + 2 * TILE_EDGE_MARGIN)


CHUNK_RECORDS = (chunk_header, header_item, coded_point)
