"""LPIPS (Zhang et al. 2018), as the field reports it beside PSNR and SSIM; needs the package `lpips` and its weights."""

from __future__ import annotations

import torch

from spec.errors import InputError

NETWORKS = ("vgg", "alex")
"""The trunks in use: 3DGS and its followers report vgg."""


class Lpips:
    """The learned distance of two images, lower is better. Its network is loaded once."""

    def __init__(self, network: str = "vgg") -> None:
        """Load the package and the network's weights; the first time, torchvision downloads them.

        Args:
            network: one of NETWORKS.

        Raises:
            InputError: another network, the package is not installed, or the weights cannot be had.
        """
        if network not in NETWORKS:
            raise InputError(f"LPIPS network {network!r} is not accepted: {' or '.join(NETWORKS)} is")
        try:
            import lpips
        except ImportError as error:
            raise InputError(f"LPIPS needs the package lpips ({error}): install the extra 'metrics'") from error
        try:
            self._distance = lpips.LPIPS(net=network, verbose=False)
        except (OSError, RuntimeError) as error:
            place = f"{torch.hub.get_dir()}/checkpoints"
            message = f"LPIPS's weights of {network} cannot be loaded ({error}): put torchvision's in {place}"
            raise InputError(message) from error

    def __call__(self, image: torch.Tensor, reference: torch.Tensor) -> float:
        """The distance of two images.

        Args:
            image, reference: (H, W, 3) floats in 0..1, of one size.

        Raises:
            ValueError: shapes differ or are not those of images.
        """
        if image.shape != reference.shape or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"images must both be (H, W, 3), not {tuple(image.shape)} and {tuple(reference.shape)}")
        with torch.no_grad():
            pair = [picture.detach().float().cpu().permute(2, 0, 1)[None] for picture in (image, reference)]
            return float(self._distance(*pair, normalize=True))  # normalize: ours are 0..1, the network's -1..1
