"""AcceleratorConfig: the one parameter object that yields the golden renderer, the RTL and the reports.

TINY is for fast simulation, PAPER has the source's resources (section 7, "Hardware Implementation"), DEFAULT is
PAPER's array with fewer front-end units and a narrower row. PRECISE, BALANCED and FAST are PAPER with the shortest word lengths
and the lowest SH degree that lose no more than 0.01, 0.1 and 0.5 dB (docs/tradeoff.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from spec.constants import ENTRY_BYTES, MAX_LEVELS, MAX_SH_DEGREE, SUPPORT_SIGMA, TILE
from spec.formats import SQ, UQ, Fixed, SmallFloat


@dataclass(frozen=True, kw_only=True)
class NumberFormats:
    """Every number format of the machine. docs/formats.md lists them with their records; tests/ justify the widths.

    The array works in the log2 domain: alpha = 2^(log2(opacity) - u^2 - v^2), where (u, v) is the pixel's offset from
    the splat's mean times the upper Cholesky factor of the conic, scaled by `constants.EXPONENT_SCALE`.
    """

    position: SmallFloat = SmallFloat(sig_bits=20, exp_bits=8, bias=127)
    """Means in memory, world units relative to the model's origin."""
    scale: SmallFloat = SmallFloat(sig_bits=12, exp_bits=6, bias=40, signed=False)
    """Standard deviations in memory, world units; zero is a degenerate axis."""
    quaternion: Fixed = SQ(0, 13)
    """Normalised quaternion components in memory."""
    log2_opacity: Fixed = SQ(4, 10)
    """log2 of the amplified opacity, -16..7 in use."""
    sh_dc: Fixed = SQ(2, 11)
    """Base colour, SH_C0 * dc + 0.5, in memory; may be negative."""
    sh_rest: Fixed = SQ(1, 10)
    """Higher SH coefficients in memory."""
    sh_basis: Fixed = SQ(0, 13)
    """SH basis functions, below 0.75 in magnitude, and every number on the way from a direction to them.

    The rounding of `colour` alone leaves 0.2887 of its ulps (rms); so few bits make that 0.291, 12 make it 0.300.
    """
    view: SmallFloat = SmallFloat(sig_bits=20, exp_bits=8, bias=127)
    """View transform and perspective division."""
    work: SmallFloat = SmallFloat(sig_bits=18, exp_bits=8, bias=127)
    """Covariance, conic and support arithmetic of the culling unit."""
    extent: SmallFloat = SmallFloat(sig_bits=9, exp_bits=5, bias=8, signed=False)
    """Reach of a footprint's bounding box in pixels, before it is widened."""
    mean2d: Fixed = SQ(14, 10)
    """Projected means in pixels."""
    conic: SmallFloat = SmallFloat(sig_bits=16, exp_bits=6, bias=63)
    """Cholesky factors of the conic; at most EXPONENT_SCALE / sqrt(LOW_PASS) = 1.551, so the largest exponent is 0."""
    colour: Fixed = UQ(1, 9)
    """Splat colours; saturating."""
    depth: Fixed = UQ(0, 14)
    """Splat depth as a fraction of the frame's depth scale; saturating."""
    depth_key: Fixed = UQ(24, 0)
    """Sort key: ulps of the `view` format between the near plane and z, so 32 octaves at full precision; saturating.

    Relative precision is what order needs: a key of 20 bits linear up to four times the 99th percentile of z lost 11 dB in
    garden_large, and needed registers that an outlier could spoil.
    """
    offset: Fixed = SQ(5, 14)
    """u and v at the tile's centre; a pair that saturates it cannot touch the tile."""
    factor: Fixed = SQ(1, 15)
    """Cholesky factors as the slopes use them: the significand of a factor of exponent 0."""
    exponent: Fixed = SQ(11, 14)
    """Exponent of alpha in the log2 domain, accumulated exactly over the tile."""
    slope: Fixed = SQ(7, 14)
    """First differences of the exponent."""
    curvature: Fixed = SQ(3, 14)
    """Second differences of the exponent."""
    cut: Fixed = SQ(3, 10)
    """Exponent below which a pixel skips the splat; its fraction is that of the exponential."""
    alpha: Fixed = UQ(1, 12)
    """Alpha, 0..1 inclusive."""
    transmittance: Fixed = UQ(0, 15)
    """Transmittance; starts at its largest value."""
    weight: Fixed = UQ(0, 12)
    """T * alpha as the accumulators see it; the weights of a pixel and its last T sum to the first T exactly."""
    accumulator: Fixed = UQ(1, 14)
    """Colour sums."""
    depth_accumulator: Fixed = UQ(0, 18)
    """Depth sums."""
    plane: Fixed = SQ(6, 12)
    """Coefficients of a tile's blend plane."""
    blend_weight: Fixed = UQ(1, 8)
    """Weight of the outer level in a blend tile, 0..1 inclusive."""
    exp2_segments: int = 16
    """Segments of the piecewise linear 2^x on [0, 1)."""

    @property
    def reach(self) -> Fixed:
        """How far a row of pixels, or an ellipse's edge, lies from a splat's mean: a difference of two `mean2d`."""
        return SQ(self.mean2d.int_bits + 1, self.mean2d.frac_bits)


WARP_FILLS = ("majority", "interior")
"""Rules of filling holes; docs/stereo.md compares them."""


_NO_LONGER = (("position", "view"), ("work", "view"), ("conic", "view"), ("scale", "work"))
"""Small floats and those they enter as they are: operands of a sum, which would not round correctly, or of wider operators."""


@dataclass(frozen=True, kw_only=True)
class AcceleratorConfig:
    """One machine. Rejects bad parameters in the constructor.

    Attributes:
        name: short name, used for folders and command lines.
        cores_x, cores_y: pixel cores of the array; both divide TILE, and an array smaller than a tile passes over it
            in blocks.
        levels: foveation levels the machine supports; more than 1, with `blend`, adds the second accumulator bank and the
            blending unit.
        sh_degree: highest degree of spherical harmonics, 0..3; coefficients of higher ones are left out of models.
        blend: tiles may blend two levels; of no account with 1 level.
        depth: depth sums present.
        fine_depth: their weights have all bits of the transmittance, as they have with `stereo` in any case.
        support_sigma: Mahalanobis support radius, or None for alpha's cut alone.
        culling_units: culling and conversion units.
        row_width: widest frame in pixels.
        line_buffer_bytes: capacity of a line buffer.
        sort_buffer_bytes: capacity of the double buffer before sorting, a power of two; see `sort_chunk`.
        incremental: stages hand over through line buffers as work becomes final; otherwise whole groups and whole tiles
            change hands through double buffers, the paper's baseline.
        merge_ways: sorted runs that are merged at a time where a group is larger than the sort buffer.
        splat_cache_lines: splats that the array's fetch unit keeps.
        counters: performance counters present.
        stereo: the warp unit and the passes of a second eye present; needs depth.
        warp_lanes: rows that the warp unit works on side by side, a pixel each a cycle.
        warp_columns: columns of the target eye that the warp unit holds, a ring; where rows are wider, pixels move by three
            quarters of them at most (`spec.stereo.reach`).
        warp_fill: which holes the warp unit fills: "majority", more than half of the neighbours that exist in strip and frame
            are warped; "interior", five are, so that only holes with rows of the strip on both sides are.
        warp_veiled: pixels of a coverage from 1/255 to 1/2, which have no depth, are warped too, by what their splats say.
        formats: number formats.
    """

    name: str
    cores_x: int = TILE
    cores_y: int = TILE
    levels: int = MAX_LEVELS
    sh_degree: int = MAX_SH_DEGREE
    blend: bool = True
    depth: bool = True
    fine_depth: bool = False
    support_sigma: float | None = SUPPORT_SIGMA
    culling_units: int = 8
    row_width: int = 1920
    line_buffer_bytes: int = 1024
    sort_buffer_bytes: int = 65536
    incremental: bool = True
    merge_ways: int = 8
    splat_cache_lines: int = 2048
    counters: bool = True
    stereo: bool = False
    warp_lanes: int = 4
    warp_columns: int = 512
    warp_fill: str = "majority"
    warp_veiled: bool = False
    formats: NumberFormats = field(default_factory=NumberFormats)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise TypeError(f"name must be a string, not {self.name!r}")
        if not self.name.isidentifier():
            raise ValueError(f"name must be an identifier, not {self.name!r}")
        for name, low, high in (
            ("cores_x", 2, TILE), ("cores_y", 2, TILE), ("levels", 1, MAX_LEVELS),
            ("sh_degree", 0, MAX_SH_DEGREE), ("culling_units", 1, 64),
            ("row_width", TILE, 8192), ("line_buffer_bytes", 64, 1 << 20),
            ("sort_buffer_bytes", 256, 1 << 24), ("merge_ways", 2, 32), ("splat_cache_lines", 4, 1 << 16),
            ("warp_lanes", 1, TILE), ("warp_columns", 4 * TILE, 8192),
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool):
                raise TypeError(f"{name} must be an integer, not {value!r}")
            if not low <= value <= high:
                raise ValueError(f"{name} must be in {low}..{high}, not {value!r}")
        for name in ("cores_x", "cores_y"):
            if TILE % getattr(self, name):
                raise ValueError(f"{name} must divide {TILE}, not {getattr(self, name)!r}")
        for name in ("sort_buffer_bytes", "merge_ways", "splat_cache_lines", "warp_lanes", "warp_columns"):
            if getattr(self, name) & (getattr(self, name) - 1):
                raise ValueError(f"{name} must be a power of two, not {getattr(self, name)!r}")
        for name in ("blend", "depth", "fine_depth", "incremental", "counters", "stereo", "warp_veiled"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"{name} must be a bool, not {getattr(self, name)!r}")
        if self.warp_fill not in WARP_FILLS:
            raise ValueError(f"warp_fill must be one of {', '.join(WARP_FILLS)}, not {self.warp_fill!r}")
        if self.stereo and not self.depth:
            raise ValueError(f"depth must be True in a machine with stereo, not {self.depth!r}")
        sigma = self.support_sigma
        if sigma is not None and (not isinstance(sigma, int | float) or isinstance(sigma, bool)):
            raise TypeError(f"support_sigma must be None or a number, not {sigma!r}")
        if sigma is not None and not 0.5 <= sigma <= 8:
            raise ValueError(f"support_sigma must be None or in 0.5..8, not {sigma!r}")
        if not isinstance(self.formats, NumberFormats):
            raise TypeError(f"formats must be NumberFormats, not {self.formats!r}")
        for name, to in _NO_LONGER:
            number, limit = getattr(self.formats, name), getattr(self.formats, to)
            if number.sig_bits > limit.sig_bits:
                raise ValueError(f"{name} must not have more significand bits than {to}, {limit.sig_bits}, not {number!r}")
        work, most = self.formats.work, self.formats.extent.sig_bits
        if work.sig_bits > 2 * most:  # an extent is the root of such a number, and could be a tie
            raise ValueError(f"work must not have more than twice the significand bits of extent, {most}, not {work!r}")

    @property
    def blocks(self) -> int:
        """Passes of the array over a tile."""
        return (TILE // self.cores_x) * (TILE // self.cores_y)

    @property
    def level_banks(self) -> int:
        """Levels accumulated side by side: 2 where blend tiles exist."""
        return 2 if self.levels > 1 and self.blend else 1

    @property
    def banks(self) -> int:
        """Accumulator banks of a pixel core: one per block and level, index `block * level_banks + level`."""
        return self.blocks * self.level_banks

    @property
    def sort_chunk(self) -> int:
        """Intersections that are sorted in one piece, a power of two: half of the double buffer before sorting."""
        return self.sort_buffer_bytes // 2 // ENTRY_BYTES

    @property
    def depth_weight(self) -> Fixed:
        """T * alpha as the depth sums see it: `weight`, or all of the transmittance where depth is what is asked for."""
        return self.formats.transmittance if self.stereo or self.fine_depth else self.formats.weight

    @property
    def point_interval(self) -> int:
        """Cycles a Gaussian takes in the near test and in projection, and a run of tiles in the tile test: 8 by one unit."""
        return max(1, 8 // self.culling_units)

    @property
    def colour_interval(self) -> int:
        """Cycles a splat takes in the colour unit: 32 by one unit."""
        return max(1, 32 // self.culling_units)

    def with_(self, **changes: object) -> AcceleratorConfig:
        """A copy with some parameters changed."""
        return replace(self, **changes)


TINY = AcceleratorConfig(
    name="tiny", cores_x=4, cores_y=4, culling_units=1, row_width=512, sort_buffer_bytes=4096, merge_ways=4,
    splat_cache_lines=64, warp_lanes=1, warp_columns=128)
DEFAULT = AcceleratorConfig(name="default", culling_units=2, row_width=1280, warp_lanes=2, warp_columns=256)
PAPER = AcceleratorConfig(name="paper")

SHORT_FORMATS = NumberFormats(
    work=SmallFloat(sig_bits=12, exp_bits=8, bias=127), conic=SmallFloat(sig_bits=15, exp_bits=6, bias=63), factor=SQ(1, 14),
    colour=UQ(1, 8), depth_key=UQ(22, 0), transmittance=UQ(0, 14), exp2_segments=8)
"""The shortest that break no hard case: by reports/tradeoff.md, whatever loss is accepted."""

PRECISE = PAPER.with_(name="precise", formats=SHORT_FORMATS)
BALANCED = PRECISE.with_(name="balanced", sh_degree=2)
FAST = PRECISE.with_(name="fast", sh_degree=1)

PRESETS = {config.name: config for config in (PRECISE, BALANCED, FAST)}
"""Recommendations of `make tradeoff`, by descending accuracy."""

CONFIGS = {config.name: config for config in (TINY, DEFAULT, PAPER, *PRESETS.values())}
