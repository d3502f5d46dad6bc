"""The steps from `paper` to all that is built for one eye: frames on machines that lack one of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from msv2.studies.area.estimate import estimate_area
from msv2.studies.energy.modelled import modelled_energy
from msv2.studies.memory import LPDDR3, memory_arguments
from msv2.studies.performance.frames import CHUNKS, SPATIAL, Compared
from msv2.studies.performance.machines import BOTH, CLOCK_HZ, MEMORIES, PEAK, SUPER, SUPER_BASE, WHOLE, Run, energies
from msv2.studies.performance.summary import geomean
from msv2.studies.performance.sweeps import at_equal_area
from perf.frames import Trace, simulate
from perf.model import MemoryModel
from spec.config import PAPER, V3, V3_PACKED, V3_RECORDS, V3_STREAMS, V3_STREAMS_PACKED, AcceleratorConfig
from spec.errors import InputError


@dataclass(frozen=True)
class Step:
    """A machine of one eye.

    Attributes:
        name: the name of its runs.
        without: what it lacks of what WHOLE has; "" for nothing, None for a machine that is in no table of steps.
        config: its configuration.
        merge: whether lists are merged.
    """

    name: str
    without: str | None
    config: AcceleratorConfig
    merge: bool = True


STEPS = (
    Step(WHOLE, "", V3_STREAMS_PACKED), Step(V3_STREAMS.name, "packed frames", V3_STREAMS_PACKED.with_(packed=False)),
    Step(V3_PACKED.name, "four arrays", V3_PACKED), Step(SUPER, "packed frames and four arrays", V3),
    Step(f"{WHOLE}, {V3.batch_places} places", f"batches of {V3_STREAMS_PACKED.batch_places}",
         V3_STREAMS_PACKED.with_(batch_places=V3.batch_places)),
    Step(f"{WHOLE}, one list a super-tile", "depth buckets", V3_STREAMS_PACKED.with_(buckets=False)),
    Step(f"{WHOLE}, not merged", "merging of lists", V3_STREAMS_PACKED, merge=False),
    Step(f"{WHOLE}, double buffers", "line buffers", V3_STREAMS_PACKED.with_(incremental=False)),
    Step(V3_RECORDS.name, "lists by super-tile", V3_RECORDS), Step(CHUNKS.name, "compact records", CHUNKS),
    Step(SPATIAL.name, "chunks", SPATIAL), Step(BOTH.name, "spatial order", PAPER))
"""The whole machine, and it without each step. Buckets, packing and arrays need lists by super-tile, these need compact
records, and so on: from V3_RECORDS on, a machine lacks all that those before it lack, too. The last one is the source."""

BASE_STEP = Step(SUPER_BASE, None, V3.with_(incremental=False), merge=False)


def _trace(frame: Compared, config: AcceleratorConfig) -> Trace:
    if config.supertiles:
        return frame.steps[(V3_STREAMS if config.streams > 1 else V3).name]
    return frame.steps.get(config.name, frame.frame)


def run_step(frame: Compared, step: Step, memory: str) -> Run:
    """A frame of one eye on a machine of STEPS. With super-tiles, the bounds of its lists are those that the same frame leaves:
    the camera stands still. A frame is packed where the machine can. A lower bound on the cycles is not known."""
    config, trace = step.config, _trace(frame, step.config)
    cycles = simulate(trace, config, memory=MemoryModel(**memory_arguments(memory)), merge=step.merge, display=True,
                      packed=config.packed)
    energy = modelled_energy(trace, cycles, config, energies(), clock_hz=CLOCK_HZ)
    render = cycles.phases["render"]
    return Run(
        step.name, memory, PEAK[memory], 1, cycles.total, cycles.phases["geometry"], render, CLOCK_HZ / cycles.total, CLOCK_HZ,
        sum(cycles.reads.values()) + sum(cycles.writes.values()), chip_mj=energy.chip_mj, dram_mj=energy.sum_mj("dram"),
        array=max(cycles.entries, cycles.ops) / (config.streams * max(1, render)),
        busy={name: stage.busy / cycles.total for name, stage in cycles.stages.items()})


def run_steps(frame: Compared) -> list[Run]:
    """A frame on the machines of STEPS and on BASE_STEP with each memory; that on PAPER is not among them, because
    `machines.run_all` has it."""
    return [run_step(frame, step, memory) for memory in MEMORIES for step in (*STEPS, BASE_STEP) if step.config is not PAPER]


def step_areas() -> dict[str, float]:
    """The area in mm^2 at 16 nm of each machine of STEPS by its name; empty without a report of areas."""
    try:
        return {step.name: estimate_area(step.config).mm2 for step in STEPS}
    except InputError:
        return {}


def over_gscore(frame: Compared, runs: Iterable[Run], areas: Mapping[str, float]) -> dict[str, list[dict[str, object]]]:
    """The machines of STEPS against GSCore scaled to the area of each, as rows of `sweeps.at_equal_area` by machine."""
    runs = list(runs)
    return {step.name: at_equal_area(frame, [run for run in runs if run.machine == step.name], areas.get(step.name))
            for step in STEPS}


def summary(
    frames: Sequence[Mapping], equal: Mapping[str, Sequence[Mapping]], areas: Mapping[str, float],
) -> list[dict[str, object]]:
    """A row for each machine of STEPS, with geometric means over the frames.

    Args:
        frames: the frames of a report, with their runs.
        equal: the rows of `over_gscore` of all frames, by machine.
        areas: those of `step_areas`.

    Returns:
        machine, without, mm2_16nm (None where it is not known). By memory: over_source and of_whole, how many times as fast as
        PAPER and as WHOLE; gscore_like_gain, how many times as fast as GSCore at equal area, and gscore_like_bound, if that got
        all that the wires can move; None without an area. With LPDDR3: bytes_gain and energy_gain over PAPER.
    """
    def ratio(of: str, machine: str, memory: str, *keys: str) -> float | None:
        """The sum of a run's values on one machine over that on another one."""
        def total(frame: Mapping, name: str) -> float:
            run = next(run for run in frame["runs"] if (run["machine"], run["memory"]) == (name, memory))
            return sum(run[key] for key in keys)

        return geomean(total(frame, of) / total(frame, machine) for frame in frames)

    out = []
    for step in STEPS:
        row: dict[str, object] = {"machine": step.name, "without": step.without, "mm2_16nm": areas.get(step.name)}
        for name, of in (("over_source", BOTH.name), ("of_whole", WHOLE)):
            row[name] = {memory: ratio(of, step.name, memory, "cycles") for memory in MEMORIES}
        for name, key in (("gscore_like_gain", "speedup"), ("gscore_like_bound", "speedup_bound")):
            row[name] = {memory: geomean(e[key] for e in equal[step.name] if e["memory"] == memory) for memory in MEMORIES}
        row["bytes_gain"] = ratio(BOTH.name, step.name, LPDDR3, "dram_bytes")
        row["energy_gain"] = ratio(BOTH.name, step.name, LPDDR3, "chip_mj", "dram_mj")
        out.append(row)
    return out
