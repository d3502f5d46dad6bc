"""LPIPS (Zhang et al. 2018), which the field reports beside PSNR and SSIM. It needs the package `lpips` and its weights."""

from __future__ import annotations

import torch

from spec.errors import InputError
from spec.extras import how_to_get

NETWORKS = ("vgg", "alex")
"""The accepted backbone networks; 3DGS and its followers report vgg."""


class Lpips:
    """The learned distance between two images; lower is better. The network is loaded once."""

    def __init__(self, network: str = "vgg") -> None:
        """Loads the package and the network's weights; the first time, torchvision downloads the weights.

        Args:
            network: one of NETWORKS.

        Raises:
            InputError: the network is none of these, the package is not installed, or the weights cannot be loaded.
        """
        if network not in NETWORKS:
            raise InputError(f"LPIPS network {network!r} is not accepted: {' or '.join(NETWORKS)} is")
        try:
            import lpips
        except ImportError as error:
            raise InputError(f"LPIPS needs the package lpips ({error}); {how_to_get('lpips')}") from error
        try:
            self._distance = lpips.LPIPS(net=network, verbose=False)
        except (OSError, RuntimeError) as error:
            place = f"{torch.hub.get_dir()}/checkpoints"
            message = f"LPIPS's weights of {network} cannot be loaded ({error}): put torchvision's in {place}"
            raise InputError(message) from error

    def __call__(self, image: torch.Tensor, reference: torch.Tensor) -> float:
        """The distance between two images.

        Args:
            image, reference: (H, W, 3) floats in 0..1, of the same size.

        Raises:
            ValueError: the shapes differ or are not (H, W, 3).
        """
        if image.shape != reference.shape or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"images must both be (H, W, 3), not {tuple(image.shape)} and {tuple(reference.shape)}")
        with torch.no_grad():
            pair = [picture.detach().float().cpu().permute(2, 0, 1)[None] for picture in (image, reference)]
            return float(self._distance(*pair, normalize=True))  # maps our 0..1 to the -1..1 that the network takes
