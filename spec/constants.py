"""Constants of the rendering semantics and of the machine, each with its derivation.

Sources: the paper (MetaSapiens v2), 3D Gaussian Splatting (Kerbl et al. 2023). Number formats are in
`spec.config`, tables in `spec.tables`.
"""

import math

TILE = 16
"""Tile edge in pixels, in every configuration (paper section 6.3)."""

MAX_LEVELS = 4
"""Foveation levels of a model (paper section 4.1)."""

SH_C0 = 0.5 / math.sqrt(math.pi)
"""Degree-0 real spherical harmonic; colour = SH_C0 * dc + 0.5."""

LOW_PASS = 0.3
"""Variance in px^2 added to both diagonal terms of the 2D covariance (3DGS): no footprint is narrower than a pixel."""

FRUSTUM_MARGIN = 1.3
"""The Jacobian's x/z and y/z are clamped to 1.3 times the frame's edges (3DGS)."""

NEAR = 0.2
"""Default near plane in world units; points with z <= near are culled (3DGS)."""

SUPPORT_SIGMA = 3.0
"""Mahalanobis radius beyond which a splat contributes nothing (3DGS's tile bound, here per pixel)."""

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

REGION_START_DEG = (0.0, 18.0, 27.0, 33.0)
"""Eccentricity at which each quality region starts (paper section 7)."""

BAND_START_DEG = (14.0, 23.5, 30.0)
"""Eccentricity at which the blend band before each of the last three regions starts."""

DISPLAY_FOV_DEG = 90.0
"""Default width of the virtual flat display, which defines eccentricity."""

SMFR_FRACTIONS = (1.0, 0.40, 0.22, 0.17)
"""Share of the points used by each level of the random-subset baseline (SMFR)."""

LOG2E_HALF = 0.5 * math.log2(math.e)
"""exp(-d^2 / 2) = 2^(-LOG2E_HALF * d^2): the factor that moves the falloff to the log2 domain."""

EXPONENT_SCALE = math.sqrt(LOG2E_HALF)
"""Folded into the Cholesky factor of the conic, so that u^2 + v^2 is the falloff's exponent in the log2 domain."""
