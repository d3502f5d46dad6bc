"""How far a frame of the machine is, from what its memory has seen: beats in the geometry phase, pixels in the rendering phase.

The machine writes no pixel before the rendering phase, which the geometry phase precedes. So beats that move before the first
pixel of a pass belong to its geometry phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Pass:
    """What is expected of the pass of one eye. All numbers are estimates, and only the progress bar depends on them.

    Attributes:
        geometry_beats: beats that the geometry phase reads and writes.
        geometry_cycles, render_cycles: cycles of the two phases.
        pixels: pixels that are written in the pass.
    """

    geometry_beats: int
    geometry_cycles: int
    render_cycles: int
    pixels: int

    @property
    def cycles(self) -> int:
        """Cycles of both phases."""
        return self.geometry_cycles + self.render_cycles


class Progress:
    """The progress of one frame.

    Args:
        passes: what is expected of the passes, in order.

    Attributes:
        total: the expected cycles of the frame.
        done: the work that is done, in the expected cycles; it never falls.
        phase: `geometry` or `rendering`.
    """

    def __init__(self, passes: Sequence[Pass]) -> None:
        self.done, self.phase = 0.0, "geometry"
        self.total = sum(item.cycles for item in passes)
        self._passes, self._pixels, self._beats, self._before = list(passes), 0, 0, 0.0

    def see(self, beats: int, pixels: int) -> None:
        """Takes the beats that memory has moved, and the pixels that it has been given, since the frame's start."""
        while len(self._passes) > 1 and pixels >= self._pixels + self._passes[0].pixels:
            first = self._passes.pop(0)
            self._before, self._pixels, self._beats = self._before + first.cycles, self._pixels + first.pixels, beats
        now = self._passes[0]
        self.phase = "rendering" if pixels > self._pixels else "geometry"
        if self.phase == "rendering":
            done = now.geometry_cycles + now.render_cycles * _share(pixels - self._pixels, now.pixels)
        else:
            done = now.geometry_cycles * _share(beats - self._beats, now.geometry_beats)
        self.done = max(self.done, self._before + done)


def _share(done: int, of: int) -> float:
    return min(done / of, 1.0) if of else 0.0
