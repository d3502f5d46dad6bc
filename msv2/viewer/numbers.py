"""The machine's numbers of a frame: intersections and cycles by the cycle model, energy by the energy study's tables."""

from __future__ import annotations

from dataclasses import dataclass

from golden.host.run_options import IDEAL, LPDDR3, RunOptions
from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.plan import Work
from msv2.studies.energy.frame import EnergyReport
from msv2.studies.energy.modelled import modelled_energy
from msv2.studies.energy.table import Table, load_table
from perf.frames import simulate, trace_of
from perf.model import FrameCycles, MemoryModel
from perf.supertiles import SuperCycles
from spec.effects import EffectPlan


@dataclass(frozen=True)
class Numbers:
    """What the machine does for a frame.

    Attributes:
        cycles: intersections, cycles, stages and memory, as `msv2 perf` gives them.
        energy: the frame's energy and rate.
        plan: the effects of the frame.
        machine: the configuration's name.
        ideal_cycles: cycles with the ideal memory, where `cycles` are those with LPDDR3; else None.
    """

    cycles: FrameCycles
    energy: EnergyReport
    plan: EffectPlan
    machine: str
    ideal_cycles: int | None = None

    @property
    def frames_per_s(self) -> float:
        """Frames a second at the clock."""
        return self.energy.clock_hz / max(self.cycles.total, 1)

    def as_json(self) -> dict[str, object]:
        """The values in JSON-ready form; the cycle model's keep the names that they have in perf.json."""
        energy = {name: value for name, value in self.energy.as_json().items() if name != "rows"}
        return {**self.cycles.as_json(), "energy": energy, "effects": self.plan.record, "frames_per_s": self.frames_per_s,
                "ideal_cycles": self.ideal_cycles}

    def summary(self) -> str:
        """The most important numbers, in Markdown."""
        return (f"**{self.frames_per_s:,.0f} frames/s** of the machine, **{self.cycles.entries:,} intersections**, "
                f"**{self.energy.total_mj:.3f} mJ**")

    def markdown(self) -> str:
        """The numbers as the viewer shows them."""
        c, e = self.cycles, self.energy
        phases = " | ".join(f"{count:,}" for count in (*c.phases.values(), c.total))
        stages = "\n".join(f"| {name} | {s.busy:,} | {s.blocked:,} | {s.starved:,} | {s.busy / max(c.total, 1):.0%} |"
                           for name, s in c.stages.items())
        active = ", ".join(f"{name}{' (forced)' if name not in self.plan.called else ''}"
                           for name in self.plan.reasons if name in self.plan.active) or "none"
        power = e.chip_mj * e.clock_hz / max(c.total, 1)
        memory = "an ideal memory" if self.ideal_cycles is None else "LPDDR3"
        bound = "" if self.ideal_cycles is None else (
            f" ({1e3 * self.ideal_cycles / e.clock_hz:.2f} ms with an ideal memory of its bandwidth, a bound)")
        lists, cache = ("lists", "cache of chunk headers") if isinstance(c, SuperCycles) else ("tiles", "splat cache")
        rows = "no rows to open" if e.counts.not_counted else f"{c.activates:,} rows opened"
        return (
            f"Machine `{self.machine}` at {e.clock_hz / 1e6:,.0f} MHz with {memory}: "
            f"{1e3 * c.total / e.clock_hz:.2f} ms a frame{bound}\n\n"
            f"| {' | '.join((*c.phases, 'total'))} |\n|{'--:|' * (len(c.phases) + 1)}\n| {phases} |\n\n"
            f"| stage | busy | blocked | starved | busy |\n|---|--:|--:|--:|--:|\n{stages}\n\n"
            f"Cycles of each phase, and of each stage's input. {c.groups:,} groups of {lists}, {c.fetch_misses:,} misses of "
            f"the {cache}, {c.dram_bytes['read'] / 1e6:.2f} MB read, {c.dram_bytes['write'] / 1e6:.2f} MB written, {rows}.\n\n"
            f"| chip, mJ | DRAM, mJ | assumed, mJ | all, mJ | chip, mW |\n|--:|--:|--:|--:|--:|\n"
            f"| {e.chip_mj:.3f} | {e.sum_mj('dram'):.3f} | {e.sum_mj('assumed'):.3f} | {e.total_mj:.3f} | {power:.0f} |\n\n"
            f"Assumed are wires and the clock tree. Effects: {active}.")


def energies() -> Table:
    """The energies of operations that the energy study uses."""
    return load_table()


def of_frame(
    golden: Frame | StereoFrame, work: Work, options: RunOptions, memory: MemoryModel, table: Table, clock_hz: float,
) -> Numbers:
    """The numbers of a golden frame.

    Args:
        golden: the frame.
        work: its request, plan and machine.
        options: how the frame runs; merging, beta and the pixels' format are read.
        memory: the memory of the cycle model.
        table: the energies of operations.
        clock_hz: the clock.
    """
    trace = trace_of(golden, record=work.request.record)
    cycles = simulate(trace, work.config, memory=memory, merge=options.merge, beta=options.beta,
                      display=options.display or isinstance(golden, StereoFrame), packed=options.packed)
    energy = modelled_energy(trace, cycles, work.config, table, clock_hz=clock_hz)
    ideal = None
    if memory.kind == LPDDR3:
        bound = simulate(trace, work.config, memory=MemoryModel(IDEAL), merge=options.merge, beta=options.beta,
                         display=options.display or isinstance(golden, StereoFrame), packed=options.packed)
        ideal = bound.total
    return Numbers(cycles, energy, work.plan, work.config.name, ideal)
