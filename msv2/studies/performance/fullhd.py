"""Full HD frames, compared with a chip that renders them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from golden.scenes.load import EMBEDDED
from msv2.studies.energy.frame import frame_energy, load_table, model_counts
from msv2.studies.memory import ALL_NAMES, LPDDR3, memory_arguments
from msv2.studies.performance.frames import TRAINED, request, scene_file
from msv2.studies.performance.machines import CLOCK_HZ, PEAK, floor_cycles
from msv2.studies.scenes import FULL_HD
from perf.model import FrameCycles, MemoryModel, simulate
from perf.trace import FrameTrace, trace_request
from spec.config import PAPER
from spec.memory import BEAT_BYTES, colour_beats
from spec.paths import ROOT, cache_folder

SIZE = "1920x1080"
CACHE = cache_folder("traces")


def full_hd(scaled_clock: float | None = None, scenes: tuple[str, ...] = FULL_HD) -> Iterator[dict[str, object]]:
    """A row for each scene that is present and each memory, LPDDR3 first.

    `scaled_frames_per_s` is the rate at the clock `scaled_clock` in GHz; None without one. LPDDR3's times are in nanoseconds
    and stay what they are. An ideal memory's bandwidth is by the cycle, so that it scales with the clock.
    """
    for scene in scenes:
        if scene != EMBEDDED and scene_file(scene) is None:
            continue
        trace = trace_request(request(scene, SIZE), PAPER, cache=CACHE)
        stored = trace.points * BEAT_BYTES * (1 + colour_beats(PAPER, trace.sh_degree))
        for memory, name in ALL_NAMES.items():
            frame = simulate(trace, PAPER, memory=MemoryModel(**memory_arguments(memory)), display=True)
            scaled = scaled_clock and _scaled(trace, frame, memory, scaled_clock)
            energy = frame_energy(model_counts(trace, frame), frame.total, PAPER, load_table(), clock_hz=CLOCK_HZ)
            yield {"frame": scene, "memory": name, "size": SIZE, "points": trace.points, "entries": trace.entries,
                   "model_mb": stored / 1e6, "quality": quality(scene), "cycles": frame.total, "phases": frame.phases,
                   "frames_per_s": CLOCK_HZ / frame.total, "scaled_frames_per_s": scaled,
                   "chip_mj": energy.chip_mj, "dram_mj": energy.sum_mj("dram"),
                   "assumed_mj": energy.sum_mj("assumed"), "dram_bytes": frame.dram_bytes["read"] + frame.dram_bytes["write"],
                   "over_floor": frame.total / floor_cycles(trace, frame, PAPER, PEAK[memory])}


def _scaled(trace: FrameTrace, frame: FrameCycles, memory: str, clock_ghz: float) -> float:
    """Frames a second at another clock, of a frame that was simulated at 1 GHz."""
    if memory == LPDDR3:
        slower = MemoryModel(**memory_arguments(memory), clock_ns=1 / clock_ghz)
        frame = simulate(trace, PAPER, memory=slower, display=True)
    return 1e9 * clock_ghz / frame.total


def quality(scene: str) -> str:
    """A description of a model's quality, from the report of its training if there is one."""
    report = ROOT / "build" / "train" / scene / "report.json"
    if scene not in TRAINED or not report.is_file():
        kind = "synthetic" if scene == EMBEDDED else "captured"
        return f"{kind} model as it is; levels are random subsets, without training"
    found = json.loads(report.read_text())
    size, loss = "x".join(map(str, found["size"])), found["psnr_l1"] - found["psnr_dense"]
    return (f"trained at {size}: level 1 {found['psnr_l1']:.2f} dB, {loss:+.2f} dB to its dense model of "
            f"{found['points']['dense']:,} points, on test views of {Path(found['scene']).name}")
