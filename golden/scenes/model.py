"""The Gaussian model in memory: every loader returns one and every renderer takes one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

MAX_LEVELS = 4
SH_REST_COUNT = {0: 0, 1: 3, 2: 8, 3: 15}  # coefficients per channel beyond the DC term, by SH degree


@dataclass(frozen=True)
class GaussianModel:
    """A set of 3D Gaussians in the INRIA trainer's conventions (log scales, wxyz quaternions, SH coefficients in the order of
    3DGS).

    Each foveation level (0-based in code, L1..L4 in text) has its own version of a point's amplified opacity and DC colour.
    A model without foveation has `levels == 1` and a quality bound of 1 everywhere.

    Attributes:
        means: (N, 3) float64, world units.
        log_scales: (N, 3) float64, natural log of the standard deviation in world units; -inf is a degenerate axis.
        quats: (N, 4) float64, wxyz, not necessarily normalised.
        opacity: (N, levels) float64, amplified opacity o_amp = amp * o of each level: not a logit, >= 0, may exceed 1.
        sh_dc: (N, levels, 3) float64, SH DC coefficient of each level; colour = sh_dc * C0 + 0.5 + rest(direction).
        sh_rest: (N, K, 3) float64, the other SH coefficients, K = 0, 3, 8 or 15, shared by all levels.
        quality_bound: (N,) uint8 in 1..levels, the highest level that uses the point (m in section 4.2 of the paper).
        up: (3,) unit vector, the scene's up direction in world axes; the orbit camera needs it.
        name: a short name for folders and reports.
        dropped: how many points the loader dropped, by reason.
        up_source: how `up` is known: "given" where it was stated, else the format of which it is the habit.

    Raises:
        ValueError: an array's shape does not suit the others, or the number of levels or of SH coefficients is impossible.
    """

    means: np.ndarray
    log_scales: np.ndarray
    quats: np.ndarray
    opacity: np.ndarray
    sh_dc: np.ndarray
    sh_rest: np.ndarray
    quality_bound: np.ndarray
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, -1.0, 0.0]))
    name: str = "model"
    dropped: dict[str, int] = field(default_factory=dict)
    up_source: str = "given"

    def __post_init__(self) -> None:
        n, levels = self.opacity.shape
        expected = {
            "means": (n, 3), "log_scales": (n, 3), "quats": (n, 4), "sh_dc": (n, levels, 3),
            "sh_rest": (n, self.sh_rest.shape[1], 3), "quality_bound": (n,),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape}, not {getattr(self, name).shape!r}")
        if not 1 <= levels <= MAX_LEVELS:
            raise ValueError(f"levels must be 1..{MAX_LEVELS}, not {levels!r}")
        if self.sh_rest.shape[1] not in SH_REST_COUNT.values():
            raise ValueError(f"sh_rest must hold 0, 3, 8 or 15 coefficients per channel, not {self.sh_rest.shape[1]!r}")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def levels(self) -> int:
        """Number of foveation levels, 1..4."""
        return self.opacity.shape[1]

    @property
    def sh_degree(self) -> int:
        """SH degree, 0..3."""
        return int(np.sqrt(self.sh_rest.shape[1] + 1)) - 1

    def select(self, index: np.ndarray) -> GaussianModel:
        """The model with only the points at `index`, a boolean mask (N,) or an integer array."""
        arrays = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
        return replace(self, **{name: getattr(self, name)[index] for name in arrays})

    def with_sh_degree(self, degree: int) -> GaussianModel:
        """The model without the SH coefficients above `degree` (0..3)."""
        return replace(self, sh_rest=self.sh_rest[:, : SH_REST_COUNT[degree]])
