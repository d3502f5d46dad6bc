"""Constants of the rendering semantics and of the machine, each with its derivation.

The sources are the paper (MetaSapiens v2) and 3D Gaussian Splatting (3DGS, Kerbl et al. 2023). Number formats are in
`spec.config`, tables in `spec.tables`.
"""

import math

TILE = 16
"""Tile edge in pixels, in every configuration (paper section 6.3)."""

SUPER_X = 8
"""Columns of tiles in a super-tile (`spec.supertiles`)."""

SUPER_Y = 2
"""Rows of tiles in a super-tile."""

SUPER_TILES = SUPER_X * SUPER_Y
"""Tiles of a super-tile."""

ENTRY_BYTES = 8
"""Bytes of an intersection (Intersection) in memory and in the sorter's buffers."""

MAX_LEVELS = 4
"""Foveation levels of a model (paper section 4.1)."""

MAX_SH_DEGREE = 3
"""Highest degree of spherical harmonics (3DGS)."""

SH_C0 = 0.5 / math.sqrt(math.pi)
"""Degree-0 real spherical harmonic; colour = SH_C0 * dc + 0.5."""

SH_C1 = 0.4886025119029199
"""Factor of the three basis functions of degree 1: sqrt(3 / 4 pi)."""

SH_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
"""Factors of degree 2, in 3DGS order and sign: of xy, yz, 2zz - xx - yy, xz, xx - yy."""

SH_C3 = (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658,
         1.445305721320277, -0.5900435899266435)
"""Factors of degree 3: of y(3xx - yy), xyz, y(4zz - xx - yy), z(2zz - 3xx - 3yy), x(4zz - xx - yy), z(xx - yy), x(xx - 3yy)."""

LOW_PASS = 0.3
"""Variance in px^2 added to both diagonal terms of the 2D covariance (3DGS): no footprint is narrower than a pixel."""

FRUSTUM_MARGIN = 1.3
"""The Jacobian's x/z and y/z are clamped to 1.3 times the frame's edges (3DGS)."""

NEAR = 0.2
"""Default near plane in world units; points with z <= near are culled (3DGS)."""

SUPPORT_SIGMA = 3.0
"""Mahalanobis radius beyond which a splat contributes nothing (3DGS's tile bound, here per pixel)."""

TILE_REACH_MARGIN = 2.0**-5
"""Margin, in log2 units, by which the tile test raises its limit of the falloff exponent. It covers the rounding of that
exponent, so that no pixel is missed."""

TILE_EDGE_MARGIN = 2.0**-5
"""Pixels by which the tile test widens every interval. This covers the rounding of the `work` format at 2,048 pixels."""

EXTENT_SHARE = 8
"""A footprint's bounding box is widened by 2^-8 of its extent. This covers the rounding of the `extent` format, which is at
most 2^-9 of the extent."""

ALPHA_MIN = 1 / 255
"""Alphas below this are skipped (3DGS)."""

ALPHA_MAX_L1 = 0.99
"""Alpha's upper bound for level 1 (3DGS); levels 2-4 may reach 1 (paper equation of the amplified alpha)."""

AMP_MAX = 128.0
"""Largest amplified opacity (paper figure on the amplifier)."""

T_STOP = 1e-4
"""A pixel stops once its transmittance falls below this, after compositing (3DGS stops before)."""

COVERAGE_VALID = 0.5
"""Depth is invalid where the accumulated alpha 1 - T is below this."""

COVERAGE_VISIBLE = 1 / 255
"""A pixel whose accumulated alpha is below this counts as background when its frame is warped. Single alphas below the same
value are skipped, see ALPHA_MIN."""

DEPTH_PERCENTILE = 99
"""Percentile of z, among the points in view, to which the depth scale is fitted, so that one outlier does not cost all other
points their resolution."""

DEPTH_REACH = 4.0
"""Depth saturates at this multiple of the z at DEPTH_PERCENTILE, or at the largest z in view if that is nearer."""

DEPTH_GAP = 16.0
"""The z at DEPTH_PERCENTILE is limited to this many times the largest z below it. Among fewer than a hundred points the
percentile lies between the last two, so that an outlier would raise it and cost all other points their resolution."""

DEPTH_NEAR_PERCENTILE = 1
"""Percentile of z, among the points in view, that stands for near points when a frame is to be warped."""

WARP_DEPTH_ERROR_PX = 1 / 8
"""Error in pixels that the rounding of depth may cause in the disparity of a point at DEPTH_NEAR_PERCENTILE. A frame that is to
be warped gets the largest depth scale that keeps to this error. A saturated depth is worse than a coarse one: it pulls all
pixels through which the splat shines to the front, whereas blending averages roundings."""

DEPTH_FRAME_MARGIN = 0.15
"""Share of its size by which the frame is widened on every side when the z of the points in view is collected, because
footprints of points outside the frame reach into it."""

REGION_START_DEG = (0.0, 18.0, 27.0, 33.0)
"""Eccentricity at which each quality region starts (paper section 7)."""

BAND_START_DEG = (14.0, 23.5, 30.0)
"""Eccentricity at which the blend band before each of the last three regions starts."""

DISPLAY_FOV_DEG = 90.0
"""Default width of the virtual flat display, which defines eccentricity."""

SMFR_FRACTIONS = (1.0, 0.40, 0.22, 0.17)
"""Share of the points used by each level of the random-subset baseline (SMFR)."""

ECC_THRESHOLD_DEG = 18.0
"""Default eccentricity beyond which the second eye's tiles may be warped (paper section 7)."""

IPD_METRES = 0.063
"""Default distance between the eyes: the average human's (paper section 7)."""

LOG2E_HALF = 0.5 * math.log2(math.e)
"""exp(-d^2 / 2) = 2^(-LOG2E_HALF * d^2): the factor that moves the falloff to the log2 domain."""

EXPONENT_SCALE = math.sqrt(LOG2E_HALF)
"""This factor is folded into the Cholesky factors of the conic, so that u^2 + v^2 is the falloff's exponent in the log2
domain."""

FLIP_FLOP_BITS = 1024
"""Bits of the largest memory that is made of flip-flops; a macro generator makes the larger ones."""
