"""Plays small frames with AXI models from outside this project: the RAM and the AXI-Lite master of cocotbext-axi replace
memory.sv and `tb.top.frames`.

Both models wake Python in every cycle, so that a simulation runs at only thousands of cycles per second. This suits frames of a
few tiles.
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
    """Plays frames as `player.play_frames` does, but of the memory's speed only `pauses` is used, and beats are not counted.

    Raises:
        SimulationError: the build or the simulation itself fails.
        ValueError: a run contains addresses that must fail.
    """
    if any(run.speed.failing != (0, 0) for run in runs):
        raise ValueError("runs must not have failing addresses: the RAM has none")
    registers, folder = prepare(runs, folder, False, watchdog)
    simulate(machine.bare_design(), "tb.top.axi_frames", folder, waves=waves, env={"PLAYER_FOLDER": str(folder)})
    return collect(registers, runs, folder)
