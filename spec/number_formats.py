"""NumberFormats: the word lengths of the machine, a part of `spec.config.AcceleratorConfig`."""

from __future__ import annotations

from dataclasses import dataclass

from spec.formats import SQ, UQ, Fixed, SmallFloat


@dataclass(frozen=True, kw_only=True)
class NumberFormats:
    """Every number format of the machine. docs/formats.md lists them with the records that use them; tests/ justify the widths.

    The array works in the log2 domain: alpha = 2^(log2(opacity) - u^2 - v^2), where (u, v) is the pixel's offset from
    the splat's mean times the upper Cholesky factor of the conic, scaled by `constants.EXPONENT_SCALE`.
    """

    position: SmallFloat = SmallFloat(sig_bits=20, exp_bits=8, bias=127)
    """Means in memory, world units relative to the model's origin."""
    scale: SmallFloat = SmallFloat(sig_bits=12, exp_bits=6, bias=40, signed=False)
    """Standard deviations in memory, in world units; zero marks a degenerate axis."""
    quaternion: Fixed = SQ(0, 13)
    """Normalised quaternion components in memory."""
    log2_opacity: Fixed = SQ(4, 10)
    """log2 of the amplified opacity. Our own models use values from -16 to 7, and a machine takes all."""
    sh_dc: Fixed = SQ(2, 11)
    """Base colour, SH_C0 * dc + 0.5, in memory; may be negative."""
    sh_rest: Fixed = SQ(1, 10)
    """Higher SH coefficients in memory."""
    sh_basis: Fixed = SQ(0, 13)
    """SH basis functions, below 0.75 in magnitude, and every intermediate number between a direction and its basis functions.

    Rounding to `colour` alone causes an error of 0.2887 ulps (rms) of `colour`. With 13 fraction bits here the whole error is
    0.291 ulps; with 12 it is 0.300.
    """
    view: SmallFloat = SmallFloat(sig_bits=20, exp_bits=8, bias=127)
    """View transform and perspective division."""
    work: SmallFloat = SmallFloat(sig_bits=18, exp_bits=8, bias=127)
    """Covariance, conic and support arithmetic of projection and of the tile test."""
    extent: SmallFloat = SmallFloat(sig_bits=9, exp_bits=5, bias=8, signed=False)
    """Distance in pixels from a splat's mean to an edge of its bounding box, before the box is widened."""
    mean2d: Fixed = SQ(14, 10)
    """Projected means in pixels."""
    conic: SmallFloat = SmallFloat(sig_bits=16, exp_bits=6, bias=63)
    """Cholesky factors of the conic; at most EXPONENT_SCALE / sqrt(LOW_PASS) = 1.551, so the largest exponent is 0."""
    colour: Fixed = UQ(1, 9)
    """Colours of splats; they saturate."""
    depth: Fixed = UQ(0, 14)
    """Depth of a splat as a fraction of the frame's depth scale; it saturates."""
    depth_key: Fixed = UQ(24, 0)
    """Sort key: the number of ulps of the `view` format between the near plane and z. It covers 32 octaves at full precision
    and saturates.

    Correct order needs relative precision. A key of 20 bits, linear up to four times the 99th percentile of z, lost 11 dB in
    garden_large, and needed registers that an outlier could spoil.
    """
    offset: Fixed = SQ(5, 14)
    """u and v at the tile's centre; where this format saturates, the splat cannot touch the tile."""
    factor: Fixed = SQ(1, 15)
    """Cholesky factors as the slopes use them: the significand of a factor whose exponent is 0."""
    exponent: Fixed = SQ(11, 14)
    """Exponent of alpha in the log2 domain; differences are accumulated exactly over the tile."""
    slope: Fixed = SQ(7, 14)
    """First differences of the exponent."""
    curvature: Fixed = SQ(3, 14)
    """Second differences of the exponent."""
    cut: Fixed = SQ(3, 10)
    """Exponent below which a pixel skips the splat; the input of the exponential has the same fraction bits. It saturates for
    opacities above 2^14, so that their splats end a little beyond their support."""
    alpha: Fixed = UQ(1, 12)
    """Alpha, 0..1 inclusive."""
    transmittance: Fixed = UQ(0, 15)
    """Transmittance T; it starts at its largest value."""
    weight: Fixed = UQ(0, 12)
    """T * alpha as the accumulators use it; the weights of a pixel and its final T sum exactly to the first T."""
    accumulator: Fixed = UQ(1, 14)
    """Colour sums."""
    depth_accumulator: Fixed = UQ(0, 18)
    """Depth sums."""
    chunk: SmallFloat = SmallFloat(sig_bits=14, exp_bits=8, bias=127)
    """The chunk test (`spec.chunks`), whose margins cover the rounding of this format."""
    plane: Fixed = SQ(6, 12)
    """Coefficients of a tile's blend plane."""
    blend_weight: Fixed = UQ(1, 8)
    """Weight of the outer level in a blend tile, 0..1 inclusive."""
    exp2_segments: int = 16
    """Segments of the piecewise linear 2^x on [0, 1)."""

    @property
    def reach(self) -> Fixed:
        """Distance of a row of pixels, or of an ellipse's edge, from a splat's mean: a difference of two `mean2d`."""
        return SQ(self.mean2d.int_bits + 1, self.mean2d.frac_bits)
