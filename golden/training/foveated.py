"""A foveated model in training: the Gaussians of level 1, and what each further level keeps of them or has of its own.

Levels are 0-based in code, L1..L4 in text. A level above L1 is a subset of the points of the level before and has its own
opacities and DC colours (selective multi-versioning, paper section 4.2). Everything else is level 1's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from golden.diff.gaussians import Gaussians, from_model
from golden.oracle.render import ALPHA_MAX
from golden.scenes.model import GaussianModel
from spec.constants import MAX_LEVELS

FLOAT_BYTES = 4
"""Parameters are stored as float32, which has this many bytes."""

BOUND_BYTES = 1
"""A quality bound is stored in one byte."""

VERSIONED_FLOATS = 4
"""Number of floats that a level above L1 adds to each of its points: the amplified opacity and three DC coefficients."""


def level_alpha_max(level: int) -> float:
    """Upper bound of alpha at a level (0-based): 3DGS's 0.99 for L1, 1 for the amplified levels."""
    return ALPHA_MAX[level]


@dataclass(frozen=True)
class Version:
    """What a level above L1 has of its own, for its n points: tensors on the base's device.

    Attributes:
        rows: (n,) int64, ascending: rows of the points in the base.
        opacity: (n,) float32 logits.
        log_amp: (n,) float32, natural log of the amplifier, >= 0.
        sh_dc: (n, 3) float32.
    """

    rows: torch.Tensor
    opacity: torch.Tensor
    log_amp: torch.Tensor
    sh_dc: torch.Tensor

    def __len__(self) -> int:
        return len(self.rows)

    def state(self) -> dict[str, torch.Tensor]:
        """The tensors by name."""
        return {"rows": self.rows, "opacity": self.opacity, "log_amp": self.log_amp, "sh_dc": self.sh_dc}


@dataclass(frozen=True)
class Storage:
    """Bytes of a model by what they hold: float32 parameters, and one byte for each quality bound.

    A point has 14 + 3 K floats, where K is the number of SH coefficients beyond the DC term (15 at degree 3, which gives 59
    floats or 236 bytes). The amplifier is not stored, because the stored opacity is the amplified one.

    Attributes:
        level1: bytes of the points of L1.
        versions: bytes of opacity and DC colour of the levels above; for separate models, of all their parameters.
        bounds: bytes of the quality bounds.
    """

    level1: int
    versions: int
    bounds: int

    @property
    def total(self) -> int:
        """Sum of all bytes."""
        return self.level1 + self.versions + self.bounds

    @property
    def overhead_percent(self) -> float:
        """What the levels add, in percent of L1 alone."""
        return 100.0 * (self.total - self.level1) / self.level1


def floats_per_point(gaussians: Gaussians) -> int:
    """Number of parameters that describe one point: 59 at SH degree 3, 14 at degree 0. The amplifier is not stored."""
    return sum(tensor[0].numel() for name, tensor in gaussians.tensors().items() if name != "log_amp")


@dataclass(frozen=True)
class FoveatedModel:
    """One to four nested levels.

    Attributes:
        base: the Gaussians of L1.
        versions: what L2, L3 and L4 have of their own, for as many levels as there are.

    Raises:
        ValueError: there are more than four levels, or a level is empty or no subset of the one before.
    """

    base: Gaussians
    versions: tuple[Version, ...] = ()

    def __post_init__(self) -> None:
        if self.levels > MAX_LEVELS:
            raise ValueError(f"levels must be 1..{MAX_LEVELS}, not {self.levels!r}")
        if not len(self.base):
            raise ValueError("base must hold at least one Gaussian, not 0")
        before = torch.ones(len(self.base), dtype=torch.bool, device=self.base.device)
        for level, version in enumerate(self.versions, start=2):
            rows = version.rows
            ascending = len(rows) > 0 and bool((rows[1:] > rows[:-1]).all()) and 0 <= rows[0] and rows[-1] < len(self.base)
            if not (ascending and bool(before[rows].all())):
                raise ValueError(
                    f"rows of level {level} must be ascending points of the level before, at least one, not {rows!r}")
            before = torch.zeros_like(before).index_fill_(0, rows, True)

    @property
    def levels(self) -> int:
        """Number of levels, 1..4."""
        return 1 + len(self.versions)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of points of each level."""
        return len(self.base), *map(len, self.versions)

    @property
    def quality_bound(self) -> torch.Tensor:
        """(N,) uint8 in 1..levels: the highest level that uses each point of the base (paper section 4.2, m)."""
        bound = torch.ones(len(self.base), dtype=torch.uint8, device=self.base.device)
        for version in self.versions:
            bound[version.rows] += 1
        return bound

    @property
    def storage(self) -> Storage:
        """Bytes: all parameters once, opacity and DC colour once more for each further level of a point, and the bounds."""
        versioned = FLOAT_BYTES * VERSIONED_FLOATS * sum(map(len, self.versions))
        bounds = BOUND_BYTES * len(self.base) if self.versions else 0
        return Storage(FLOAT_BYTES * floats_per_point(self.base) * len(self.base), versioned, bounds)

    def level(self, index: int) -> Gaussians:
        """The Gaussians of a level (0-based), detached; those of L1 share the base's memory."""
        if index not in range(self.levels):
            raise ValueError(f"level must be 0..{self.levels - 1}, not {index!r}")
        if index == 0:
            return self.base.map(torch.Tensor.detach)
        version = self.versions[index - 1]
        return replace(self.base.select(version.rows), opacity=version.opacity, log_amp=version.log_amp, sh_dc=version.sh_dc)

    def with_level(self, version: Version) -> FoveatedModel:
        """The model with one more level."""
        return FoveatedModel(self.base, (*self.versions, version))

    def truncated(self, levels: int) -> FoveatedModel:
        """The model with only its first `levels` levels."""
        return FoveatedModel(self.base, self.versions[: levels - 1])

    def to(self, device: torch.device | str) -> FoveatedModel:
        """The model on another device."""
        moved = [Version(**{name: tensor.to(device) for name, tensor in v.state().items()}) for v in self.versions]
        return FoveatedModel(self.base.to(device), tuple(moved))

    def to_model(self, *, up: np.ndarray, name: str) -> GaussianModel:
        """The model for files and renderers: points in the base's order, amplified opacities of at most AMP_MAX.

        At levels beyond its quality bound, a point repeats the values of its last level; no renderer reads them.
        """
        def array(tensor: torch.Tensor) -> np.ndarray:
            return tensor.detach().cpu().numpy().astype(np.float64)

        opacity, sh_dc = [array(self.base.amplified_opacity)], [array(self.base.sh_dc)]
        for index, version in enumerate(self.versions, start=1):
            rows = version.rows.cpu().numpy()
            opacity.append(opacity[-1].copy())
            sh_dc.append(sh_dc[-1].copy())
            opacity[-1][rows] = array(self.level(index).amplified_opacity)
            sh_dc[-1][rows] = array(version.sh_dc)
        base = self.base
        return GaussianModel(
            means=array(base.means), log_scales=array(base.log_scales), quats=array(base.quats),
            opacity=np.stack(opacity, axis=1), sh_dc=np.stack(sh_dc, axis=1), sh_rest=array(base.sh_rest),
            quality_bound=self.quality_bound.cpu().numpy(), up=up, name=name)

    def state(self) -> dict[str, object]:
        """Everything that `from_state` needs, for `torch.save`."""
        base = self.base.map(torch.Tensor.detach).tensors()
        return {"base": base, "versions": [version.state() for version in self.versions]}

    @classmethod
    def from_state(cls, state: dict[str, object]) -> FoveatedModel:
        """The model whose `state` this is."""
        return cls(Gaussians(**state["base"]), tuple(Version(**version) for version in state["versions"]))

    @classmethod
    def from_model(cls, model: GaussianModel, device: torch.device | str = "cpu") -> FoveatedModel:
        """A model from a file; an opacity above 1 is split into opacity 1 and an amplifier."""
        bound, versions = torch.from_numpy(model.quality_bound.astype(np.int64)).to(device), []
        for level in range(1, model.levels):
            alone = from_model(_level_of(model, level), device)
            rows = torch.nonzero(bound > level)[:, 0]
            versions.append(Version(rows, alone.opacity[rows], alone.log_amp[rows], alone.sh_dc[rows]))
        return cls(from_model(model, device), tuple(versions))

    @classmethod
    def nested(cls, base: Gaussians, quality_bound: Sequence[int] | np.ndarray) -> FoveatedModel:
        """Levels that differ only in their points: level L (0-based) has the points with a quality bound above L, with the
        values of L1."""
        bound = torch.as_tensor(np.asarray(quality_bound, np.int64), device=base.device)
        versions = []
        for level in range(1, int(bound.max())):
            rows = torch.nonzero(bound > level)[:, 0]
            kept = base.select(rows)
            versions.append(Version(rows, kept.opacity, kept.log_amp, kept.sh_dc))
        return cls(base, tuple(versions))


def _level_of(model: GaussianModel, level: int) -> GaussianModel:
    """All points of a model with the opacities and colours of one level."""
    return replace(
        model, opacity=model.opacity[:, level : level + 1], sh_dc=model.sh_dc[:, level : level + 1],
        quality_bound=np.ones(len(model), np.uint8))
