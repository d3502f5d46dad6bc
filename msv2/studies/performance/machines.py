"""The machines that are compared, and how a frame runs on each of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cache

from msv2.studies.energy.frame import Table, frame_energy, load_table, model_counts
from msv2.studies.memory import ALL_NAMES, IDEAL, LPDDR3, UNLIMITED, memory_arguments
from msv2.studies.performance.frames import Compared
from msv2.studies.performance.gpu import gpu_frame
from perf.gscore import GscoreConfig, gscore_cycles
from perf.model import FrameCycles, MemoryModel, simulate
from perf.trace import FrameTrace
from spec.config import PAPER, PAPER_BASE, V3, V3_STREAMS_PACKED, AcceleratorConfig
from spec.memory import DRAM_BYTES_PER_CYCLE

CLOCK_HZ = 1e9
MEMORIES = tuple(ALL_NAMES)
"""The memories with which every frame is simulated, LPDDR3 first; the ideal ones beside it are bounds."""

UNLIMITED_BYTES = 64
"""Bytes per cycle of other machines where ours reads a beat and writes a beat in every cycle."""

PEAK = {LPDDR3: DRAM_BYTES_PER_CYCLE, IDEAL: DRAM_BYTES_PER_CYCLE, UNLIMITED: None}
"""The most bytes per cycle that a memory moves; None for a beat read and a beat written in every cycle."""


@dataclass(frozen=True)
class Machine:
    """A variant of our machine: whether tiles are merged, whether stages hand over incrementally or through double buffers, and
    whether these swap together (`spec.config.PAPER_BASE`)."""

    name: str
    merge: bool
    pipeline: bool
    lockstep: bool = False

    @property
    def config(self) -> AcceleratorConfig:
        """Its configuration."""
        return PAPER_BASE if self.lockstep else PAPER.with_(incremental=self.pipeline)


MACHINES = (
    Machine("base", False, False), Machine("merging", True, False), Machine("pipelining", False, True),
    Machine("merging+pipelining", True, True))
BASE, BOTH = MACHINES[0], MACHINES[-1]
LOCKSTEP = Machine(PAPER_BASE.name, False, False, lockstep=True)
"""Our reading of the paper's baseline."""

SUPER, SUPER_BASE = V3.name, f"{V3.name}, double buffers"
"""The machine with lists by super-tile as it is, and without merging and line buffers (`msv2 perf --pipeline 0 --merge 0`),
both for one eye."""

WHOLE = V3_STREAMS_PACKED.name
"""The machine with all that is built for one eye (`msv2.studies.performance.steps`)."""

TWO_BASE, TWO_BOTH, WARPING = "base, two eyes", "merging+pipelining, two eyes", "merging+pipelining+warping"
GSCORE, GPU = "GSCore-like", "mobile GPU (modelled)"
GEOMETRY_READS, GEOMETRY_WRITES = ("geometry", "colour"), ("entries", "views")
"""The memory clients that belong to the geometry phase."""


@dataclass(frozen=True)
class Run:
    """A frame on a machine.

    Attributes:
        machine: the machine's name.
        memory: one of MEMORIES. The GPU has a memory of its own, and is compared with ours beside each of them.
        bytes_per_cycle: the most bytes that the memory moves in a cycle; None if it is unlimited.
        eyes: the number of eyes of the frame.
        cycles, geometry, render: the cycles of the frame and of its two phases; None where the machine has no such number.
        frames_per_s: the frame rate at `clock_hz`.
        dram_bytes: the bytes moved.
        chip_mj, dram_mj: energies; None where they are not known.
        floor: a lower bound on the frame's cycles (`floor_cycles`).
        array: the share of the rendering phase in which the array has work, or arrays have on average.
        busy: the share of the frame in which each stage has work, by the stage's name; None where it is not told.
    """

    machine: str
    memory: str
    bytes_per_cycle: float | None
    eyes: int
    cycles: float
    geometry: float | None
    render: float | None
    frames_per_s: float
    clock_hz: float
    dram_bytes: int
    chip_mj: float | None = None
    dram_mj: float | None = None
    floor: float | None = None
    array: float | None = None
    busy: dict[str, float] | None = None


@cache
def energies() -> Table:
    """The measured energies of operations."""
    return load_table()


def floor_cycles(trace: FrameTrace, f: FrameCycles, config: AcceleratorConfig, bytes_per_cycle: float | None) -> float:
    """A lower bound on the cycles of a frame: the busiest part of every phase, without waiting.

    In the geometry phase, points come at the culling units' rate, survivors at the colour unit's, and bytes at memory's. In the
    rendering phase, an intersection or an operation takes a cycle, and bytes come at memory's rate.
    """
    reads = sum(f.reads[name] for name in GEOMETRY_READS), sum(n for name, n in f.reads.items() if name not in GEOMETRY_READS)
    writes = (sum(f.writes[name] for name in GEOMETRY_WRITES),
              sum(n for name, n in f.writes.items() if name not in GEOMETRY_WRITES))

    def memory(read: int, written: int) -> float:
        return max(read, written) / (UNLIMITED_BYTES / 2) if bytes_per_cycle is None else (read + written) / bytes_per_cycle

    points = trace.points * len(trace.eyes) * config.point_interval
    colours = sum(len(eye.survivor) for eye in trace.eyes) * config.colour_interval
    return max(points, colours, memory(reads[0], writes[0])) + max(trace.entries, f.ops, memory(reads[1], writes[1]))


def run_ours(
    name: str, traces: Iterable[FrameTrace], config: AcceleratorConfig, memory: str, *, merge: bool, beta: int | None = None,
    bandwidth: float | None = None,
) -> tuple[Run, list[FrameCycles]]:
    """One or more frames, one after the other, on one of our machines. `bandwidth` is one for the ideal memory, other than the
    paper's."""
    traces, peak = tuple(traces), bandwidth or PEAK[memory]
    model = MemoryModel(**memory_arguments(memory) | ({"bytes_per_cycle": bandwidth} if bandwidth else {}))
    frames = [simulate(trace, config, memory=model, merge=merge, beta=beta, display=True) for trace in traces]
    energy = [frame_energy(model_counts(trace, frame), frame.total, config, energies(), clock_hz=CLOCK_HZ)
              for trace, frame in zip(traces, frames, strict=True)]
    cycles, render = sum(f.total for f in frames), sum(f.phases["render"] for f in frames)
    return Run(
        name, memory, peak, sum(len(trace.eyes) for trace in traces), cycles, sum(f.phases["geometry"] for f in frames),
        render, CLOCK_HZ / cycles, CLOCK_HZ, sum(sum(f.reads.values()) + sum(f.writes.values()) for f in frames),
        chip_mj=sum(e.chip_mj for e in energy), dram_mj=sum(e.sum_mj("dram") for e in energy),
        floor=sum(floor_cycles(t, f, config, peak) for t, f in zip(traces, frames, strict=True)),
        array=sum(max(f.entries, f.ops) for f in frames) / max(1, render)), frames


def run_gscore(
    frame: Compared, memory: str, factor: float = 1.0, name: str = GSCORE, *, rate: float | None = None,
) -> Run:
    """A frame on the GSCore-like machine with `factor` times the published units. Its energy is not modelled.

    Its accesses to the rows of DRAM are not modelled, either. With LPDDR3 it is assumed to get as many bytes in a cycle as our
    machine does in the same frame: `rate`, which is else a bandwidth other than the memory's own.

    Raises:
        ValueError: there is no rate with LPDDR3.
    """
    if memory == LPDDR3 and rate is None:
        raise ValueError("rate must be a number with LPDDR3, not None")
    peak = rate or PEAK[memory]
    c = gscore_cycles(frame.gscore, GscoreConfig(bytes_per_cycle=peak or UNLIMITED_BYTES).scaled(factor))
    return Run(name, memory, peak, 1, c.total, c.geometry, c.render, CLOCK_HZ / c.total, CLOCK_HZ, c.dram_bytes)


def rate_for_gscore(ours: Run) -> float | None:
    """The bytes in a cycle that the GSCore-like machine gets with the memory of our run; None for the memory's own."""
    return ours.dram_bytes / ours.cycles if ours.memory == LPDDR3 else None


def run_gpu(frame: Compared, memory: str, ops: int) -> Run:
    """A frame on the mobile GPU, by its roofline; the cycles are those of its own clock."""
    g = gpu_frame(frame.frame, ops)
    return Run(GPU, memory, g.bytes_per_cycle, 1, g.seconds * g.clock_hz, None, None, 1 / g.seconds, g.clock_hz, g.dram_bytes)


def run_all(frame: Compared) -> tuple[list[Run], FrameCycles]:
    """A frame on all machines with lists by tile, on GSCore and on the GPU with each memory, and its cycles on the full machine
    with LPDDR3."""
    runs, kept = [], None
    for memory in MEMORIES:
        for m in (*MACHINES, LOCKSTEP):
            run, cycles = run_ours(m.name, [frame.frame], m.config, memory, merge=m.merge)
            runs.append(run)
            if m is BOTH:
                kept = kept or cycles[0]
        eyes = (frame.frame, frame.other)
        runs.append(run_ours(TWO_BASE, eyes, PAPER.with_(incremental=False), memory, merge=False)[0])
        runs.append(run_ours(TWO_BOTH, eyes, PAPER, memory, merge=True)[0])
        runs.append(run_ours(WARPING, [frame.warped], PAPER.with_(stereo=True), memory, merge=True)[0])
        ours = next(r for r in runs if (r.machine, r.memory) == (BOTH.name, memory))
        runs.append(run_gscore(frame, memory, rate=rate_for_gscore(ours)))
        runs.append(run_gpu(frame, memory, kept.ops))
    return runs, kept


def rows(runs: Iterable[Run]) -> list[dict[str, object]]:
    """The runs as JSON-ready rows, with each machine's speedup over the base machine with as many eyes."""
    runs = list(runs)
    base = {(r.eyes, r.memory): r for r in runs if r.machine in (BASE.name, TWO_BASE)}
    out = []
    for r in runs:
        b = base[r.eyes, r.memory]
        speedups = {"speedup": r.frames_per_s / b.frames_per_s, "speedup_render": b.render / r.render if r.render else None,
                    "energy_ratio": None if r.chip_mj is None else (b.chip_mj + b.dram_mj) / (r.chip_mj + r.dram_mj),
                    "energy_ratio_chip": None if r.chip_mj is None else b.chip_mj / r.chip_mj}
        out.append(asdict(r) | speedups)
    return out
