"""How HVSQ pools for each level of a foveated model: the widths of the windows and their kind."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from golden.metrics.hvsq import FULL_WIDTH, Hvsq, pooling_px
from golden.metrics.pooling import KINDS
from spec.constants import MAX_LEVELS
from spec.errors import InputError


@dataclass(frozen=True)
class LevelPooling:
    """The pooling of L1 to L4.

    Attributes:
        display_width: the windows are as in a frame of this many pixels in width that shows the paper's whole display. At
            FULL_WIDTH they are the paper's 1, 3, 7 and 12 pixels. With a frame's own width, the frame is assumed to be shown as
            large as the paper's, so that its pixels are coarser and fewer of them are pooled.
        kind: one of `golden.metrics.pooling.KINDS`. The paper's numbers were made with blocks.
    """

    display_width: int = FULL_WIDTH
    kind: str = "blocks"

    def __post_init__(self) -> None:
        if self.display_width < 1:
            raise InputError(f"pooling-width {self.display_width} is not accepted: 1 or more is")
        if self.kind not in KINDS:
            raise InputError(f"pooling {self.kind!r} is not accepted: choose one of {', '.join(KINDS)}")

    @property
    def widths(self) -> tuple[float, ...]:
        """Width of the windows in pixels for L1 to L4; a width below 1 acts as 1."""
        return tuple(pooling_px(level, self.display_width) for level in range(MAX_LEVELS))

    def hvsq(self, reference: torch.Tensor, level: int) -> Hvsq:
        """The metric of a 0-based level against a reference (H, W, 3)."""
        return Hvsq(reference, self.widths[level], self.kind)

    def of_kind(self, kind: str) -> LevelPooling:
        """The same widths with windows of another kind."""
        return replace(self, kind=kind)
