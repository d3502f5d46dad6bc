"""Chunks of a model: up to 64 Gaussians with a header of one beat, and the test by which the machine skips a whole chunk.

Chunk c holds the Gaussians `first` .. `first + count - 1`, all of the same quality bound. Chunks follow each other without a gap
between their indices. The headers lie in the region `chunks`, one beat each, in order.

**The box.** It reaches from `low` to `low` + (`extent` + 1) * 2^(`step` + BOX_SHIFT - STEP_BIAS) along each axis, and contains the
mean of every Gaussian of the chunk as its words have it.

**The chunk test** never skips a chunk with a splat that has an intersection. Every number below is a small float: `o` has format
`view`, all others format `chunk` of `spec.config`, and every operation rounds to the format of its result, HALF_EVEN. A sum of
three is (a + b) + c. Settings are rounded to `chunk` before they are used, except `position`. i is an axis of the world, k one of
the camera::

    h[i] = (extent[i] + 1) * 2^(step[i] + BOX_SHIFT - STEP_BIAS - 1)      half of the box; exact
    w[i] = (extent[i] + 2) * 2^(step[i] + BOX_SHIFT - STEP_BIAS - 1)      the same, widened; exact
    o[i] = low[i] - position[i]
    a[i] = chunk(o[i]) + h[i]                                             the box's centre relative to the camera
    g[i] = w[i] + |a[i]| * 2^-CENTRE_MARGIN                               the product is exact
    v[k] = rotation[k][0] * a[0] + rotation[k][1] * a[1] + rotation[k][2] * a[2]
    s[k] = |rotation[k][0]| * g[0] + |rotation[k][1]| * g[1] + |rotation[k][2]| * g[2]
    lo[k] = v[k] - s[k],  hi[k] = v[k] + s[k]

The rows x and y of `rotation` contain the focal lengths. Rows and numbers with k = z are depths. The chunk is *behind* where
hi[z] <= near. Otherwise::

    q0 = 1 / max(lo[z], near)
    q1 = 1 / hi[z]
    sigma = largest standard deviation of the chunk, see `sigma_format` and SIGMA_FRACTIONS
    left[k]  = lo[k] * (q1 if lo[k] >= 0 else q0) - reach[k] * (sigma * q0)
    right[k] = hi[k] * (q0 if hi[k] >= 0 else q1) + reach[k] * (sigma * q0)       for k = x, y

`reach` is a setting: by how many pixels a splat with a standard deviation of 1 at z = 1 reaches at most, where the Jacobian is
clamped (FRUSTUM_MARGIN), times 1 + REACH_MARGIN. Integers follow; floor(x) saturates to PIXEL_BITS bits and a sign::

    first[k] = (floor(left[k]) + (centre[k] >> frac_bits) - PAD) >> 4
    last[k] = (floor(right[k]) + (centre[k] >> frac_bits) + PAD) >> 4

These are the first and the last column (row) of tiles that the chunk's splats can touch. The chunk is *outside* where last < 0 or
first is beyond the frame's last tile. Otherwise both are clamped to the frame.

For each quality bound b, the machine keeps the *level bounds* of the frame: the smallest and the largest x, y, x + y and x - y of
all tiles (x, y) that are rendered and whose level is at most b. The chunk is *filtered* where no tile is in the octagon of its
own bound b that also lies in its box: no such tile exists, or first[x] > x_most, last[x] < x_least, the same for y,
first[x] + first[y] > sum_most, last[x] + last[y] < sum_least, first[x] - last[y] > difference_most, or
last[x] - first[y] < difference_least.

The chunk is *faint* where its opacity's code is 0. A chunk that is behind, outside, filtered or faint is skipped; its first reason
in the order behind, faint, outside, filtered counts nowhere: there is one counter for all.

**Why no survivor is lost.** Roundings change v by at most 6 * 2^-14 of the sum of |rotation| * |a|, which CENTRE_MARGIN covers,
and s by 4 * 2^-14 of itself, which the widening of w covers, because an extent has 8 bits. Larger intervals come from the
roundings of lo[z] and hi[z] in the same way. PAD covers the low-pass filter (3 sigma of LOW_PASS), the roundings of quotients up
to 8,192 pixels, and the tile test's own margins. tests/golden/msv2_ref/test_chunk_test.py tries it on random models and cameras.
"""

from __future__ import annotations

import math

from spec.compact import OPACITY_BITS
from spec.config import AcceleratorConfig
from spec.formats import SQ, Fixed, SmallFloat
from spec.records import INDEX_BITS, Field, Record, uint

CHUNK = 64
"""Gaussians of a full chunk."""

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

SIGMA_FRACTIONS = tuple(math.ceil((1 << 13) * 2 ** (i / SCALE_TOP_STEPS)) for i in range(SCALE_TOP_STEPS))
"""Significands (14 bits, rounded up) of 2^(i / 16). A chunk's sigma has exponent (scale_top >> 4) - bias of `scale` and the
significand SIGMA_FRACTIONS[scale_top & 15]."""

CENTRE_MARGIN = 10
"""-log2 of the share of a box's distance by which the box is widened."""

REACH_MARGIN = 2.0**-6
"""Share by which `reach` is larger than needed: quaternions are not exactly normalised, and boxes of footprints are widened."""

WIDEST_SIGMA = 4.6
"""Standard deviations at which the largest amplified opacity falls below 1/255, where no support ends a splat before."""

PAD = 6
"""Pixels by which a chunk's interval is widened."""

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


def pixel_format() -> Fixed:
    """The format to which the chunk test's pixel coordinates are floored."""
    return SQ(PIXEL_BITS, 0)


def sigma_format(config: AcceleratorConfig) -> SmallFloat:
    """The format of a chunk's sigma: that of the chunk test."""
    return config.formats.chunk


def support(config: AcceleratorConfig) -> float:
    """Standard deviations at which a splat of any opacity ends."""
    return min(config.support_sigma or WIDEST_SIGMA, WIDEST_SIGMA)


CHUNK_RECORDS = (chunk_header,)
