"""The Gaussians of one level as trainable tensors: optimisers change them, renderers draw them, training stages pass them
on."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch

from golden.scenes.conventions import logit
from golden.scenes.model import GaussianModel
from spec.constants import AMP_MAX

OPACITY_LOGIT_MAX = 16.0
"""Opacities are clipped to this logit, 1.1e-7 below opacity 1, because opacity 1 has no finite logit."""


@dataclass
class Gaussians:
    """N Gaussians of one level, float32 tensors on one device, in the units of `GaussianModel`.

    Attributes:
        means: (N, 3) world units.
        log_scales: (N, 3) natural log of the standard deviations in world units.
        quats: (N, 4) wxyz, not necessarily normalised.
        opacity: (N,) logits.
        log_amp: (N,) natural log of the opacity amplifier, >= 0 where it is used; 0 leaves the opacity as it is.
        sh_dc: (N, 3) SH DC coefficients.
        sh_rest: (N, K, 3), K = 0, 3, 8 or 15.
    """

    means: torch.Tensor
    log_scales: torch.Tensor
    quats: torch.Tensor
    opacity: torch.Tensor
    log_amp: torch.Tensor
    sh_dc: torch.Tensor
    sh_rest: torch.Tensor

    def __len__(self) -> int:
        return len(self.means)

    def tensors(self) -> dict[str, torch.Tensor]:
        """The fields by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def map(self, change: object) -> Gaussians:
        """The Gaussians with each field replaced by `change(tensor)`."""
        return Gaussians(**{name: change(tensor) for name, tensor in self.tensors().items()})

    def select(self, index: torch.Tensor) -> Gaussians:
        """The rows at `index` (a boolean mask or integers), detached from the graph."""
        return self.map(lambda tensor: tensor.detach()[index])

    def detached(self) -> Gaussians:
        """A copy that shares no memory and needs no gradient."""
        return self.map(lambda tensor: tensor.detach().clone())

    def to(self, device: torch.device | str) -> Gaussians:
        """The Gaussians on another device."""
        return self.map(lambda tensor: tensor.to(device))

    @property
    def device(self) -> torch.device:
        """The device of the tensors."""
        return self.means.device

    @property
    def amplified_opacity(self) -> torch.Tensor:
        """(N,) o_amp = amp * o (the paper's equation of the amplifier), at most AMP_MAX."""
        return (torch.sigmoid(self.opacity) * torch.exp(self.log_amp)).clamp(max=AMP_MAX)


def from_model(model: GaussianModel, device: torch.device | str = "cpu") -> Gaussians:
    """Level 1 of a model as tensors; an opacity above 1 is split into opacity 1 and an amplifier."""
    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(device)

    opacity = model.opacity[:, 0]
    logits = np.clip(logit(np.minimum(opacity, 1.0)), -OPACITY_LOGIT_MAX, OPACITY_LOGIT_MAX)
    return Gaussians(
        tensor(model.means), tensor(model.log_scales), tensor(model.quats), tensor(logits),
        tensor(np.log(np.maximum(opacity, 1.0))), tensor(model.sh_dc[:, 0]), tensor(model.sh_rest))


def to_model(gaussians: Gaussians, *, up: np.ndarray, name: str) -> GaussianModel:
    """A model of one level from the tensors."""
    def array(tensor: torch.Tensor) -> np.ndarray:
        return tensor.detach().cpu().numpy().astype(np.float64)

    g = gaussians
    return GaussianModel(
        means=array(g.means), log_scales=array(g.log_scales), quats=array(g.quats), opacity=array(g.amplified_opacity)[:, None],
        sh_dc=array(g.sh_dc)[:, None], sh_rest=array(g.sh_rest), quality_bound=np.ones(len(g), np.uint8), up=up, name=name)
