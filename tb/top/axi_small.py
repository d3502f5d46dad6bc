"""Small frames with models of AXI that are not ours: cocotbext-axi's RAM and AXI-Lite master instead of memory.sv and `frames`.

Thousands of cycles a second, because both models wake Python in every cycle: for frames of a few tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tb.common.runner import Waves, simulate
from tb.top.device import Machine
from tb.top.player import FrameResult, FrameRun, collect, prepare


def play_small(
    machine: Machine, runs: Sequence[FrameRun], folder: Path, *, waves: Waves | None = None, watchdog: int = 20_000,
) -> list[FrameResult]:
    """As `player.play_frames`, but for the memory's speed: of it, `pauses` alone counts. Beats are not counted.

    Raises:
        SimulationError: the build or the simulation itself fails.
        ValueError: a run wants addresses that fail.
    """
    if any(run.speed.failing != (0, 0) for run in runs):
        raise ValueError("runs must not have failing addresses: the RAM has none")
    registers, folder = prepare(runs, folder, False, watchdog)
    simulate(machine.bare_design(), "tb.top.axi_frames", folder, waves=waves, env={"PLAYER_FOLDER": str(folder)})
    return collect(registers, runs, folder)
