"""The energy of a frame: operations times their measured energies, cycles times clock energy, time times leakage, and what
memory takes for its commands, its bits and its standby.

    trace, cycles = trace_request(...), simulate(...)
    report = frame_energy(model_counts(trace, cycles), cycles.total, config, load_table())

A unit's energy has three parts: dynamic (its operations), clock (every cycle of the frame, whether the unit works or not,
because no whole unit is clock-gated) and leakage. Its memories are counted apart, by access. The energies of wires and of the
clock tree, which no netlist shows, are those of a few placed units, assumed for all (`msv2.studies.energy.estimates`). They
have rows of their own and are part of no sum but the total.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING

from msv2.studies.energy.dram import GROUPS, LPDDR3, Dram
from msv2.studies.energy.estimates import Share, estimates
from msv2.studies.energy.memories import configured
from msv2.studies.energy.sources import SRAM_LEAKAGE_SHARE, SRAM_NODE, SRAM_SCALING, SRAM_SOURCE, sram_access_pj
from msv2.studies.energy.table import Table, Unit, load_table
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BYTES

if TYPE_CHECKING:  # a frame's counters must not need the model's compiler
    from perf.model import FrameCycles
    from perf.trace import FrameTrace

__all__ = ["EnergyReport", "EnergyRow", "Table", "WorkCounts", "counter_counts", "frame_energy", "load_table", "model_counts"]

PARTS = ("dynamic", "clock", "leakage", "sram", "dram", "assumed")
"""The kinds of rows."""

CHIP = ("dynamic", "clock", "leakage", "sram")
"""The kinds of rows that belong to the chip itself."""

DRAM_COMMANDS = ("activates", "refreshes")
"""The counts that only a memory with rows has."""

DRAM_UNIT = "dram: "
"""What the units of DRAM's rows begin with; one of `msv2.studies.energy.dram.GROUPS` follows."""

PJ_TO_MJ = 1e-9
NOT_SCALED = "none: not of the chip's node"


@dataclass(frozen=True)
class WorkCounts:
    """The operations of a frame, of both eyes together, under the names of the machine's counters.

    Attributes:
        points, survivors, entries, spilled_entries, ops, pixels, warped: events that `spec.registers` defines.
        tiles: entries of the tile table, which is read once per pass.
        read_beats, write_beats: beats of memory.
        activates, refreshes: commands of the DRAM's channels. None where they are not known, because the frame ran with the
            ideal memory, which has no rows; they are not counted then.
    """

    points: int = 0
    survivors: int = 0
    entries: int = 0
    spilled_entries: int = 0
    ops: int = 0
    pixels: int = 0
    warped: int = 0
    tiles: int = 0
    read_beats: int = 0
    write_beats: int = 0
    activates: int | None = None
    refreshes: int | None = None

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value is None and name in DRAM_COMMANDS:
                continue
            if not isinstance(value, int) or isinstance(value, bool) or value < 0:
                raise ValueError(f"{name} must be an integer, 0 or more, not {value!r}")

    def of(self, operation: str) -> int:
        """The number of a unit's operations: a field, or a sum of fields."""
        if operation == "sorted_entries":
            return self.entries + self.spilled_entries
        if operation == "beats":
            return self.read_beats + self.write_beats
        if operation == "cycles":
            return 0
        if operation not in {f.name for f in fields(self)} - set(DRAM_COMMANDS):
            raise ValueError(f"operation must be a count of a frame, not {operation!r}")
        return getattr(self, operation)

    @property
    def not_counted(self) -> tuple[str, ...]:
        """Names of the commands that are not known."""
        return tuple(name for name in DRAM_COMMANDS if getattr(self, name) is None)


@dataclass(frozen=True)
class EnergyRow:
    """A part of a frame's energy.

    Attributes:
        unit: a unit of the machine, or a part of DRAM's energy (DRAM_UNIT), or the name of an assumption.
        part: one of PARTS.
        value_mj: the energy per frame.
        operations, operation: the number of operations, and what they are.
        coefficient_pj: the energy of one operation, at the node of the frame's energy.
        node, source, scaling: where the coefficient comes from.
    """

    unit: str
    part: str
    value_mj: float
    operations: float
    operation: str
    coefficient_pj: float
    node: str
    source: str
    scaling: str


@dataclass(frozen=True)
class EnergyReport:
    """The energy of a frame.

    Attributes:
        rows: all parts.
        cycles, clock_hz: the frame's cycles and the clock.
        counts: the frame's operations.
    """

    rows: tuple[EnergyRow, ...]
    cycles: int
    clock_hz: float
    counts: WorkCounts

    def sum_mj(self, *parts: str) -> float:
        """The energy of the rows of these kinds; without arguments, that of all rows."""
        return sum(row.value_mj for row in self.rows if not parts or row.part in parts)

    @property
    def chip_mj(self) -> float:
        """The energy of logic and memories on the chip, without assumptions."""
        return self.sum_mj(*CHIP)

    @property
    def total_mj(self) -> float:
        """The energy of all rows."""
        return self.sum_mj()

    @property
    def other_chip_mj(self) -> float:
        """The energy of the chip if its logic at 16 nm is what Nangate45 says instead of ASAP7; memories and leakage stay."""
        return self.sum_mj("sram", "leakage") + estimates().anchor.value * self.sum_mj("dynamic", "clock")

    @property
    def range_mj(self) -> tuple[float, float]:
        """The least and the most that all rows may be by what is known of units: the library that says less with the smallest
        shares of wires and clock tree, the one that says more with the largest. DRAM has no range: its currents are those of
        data sheets."""
        known, ends = estimates(), []
        for anchor, end in ((min(1.0, known.anchor.low), "low"), (max(1.0, known.anchor.high), "high")):
            grown = sum(row.value_mj * getattr(share, end) / share.value for row in self.rows for name, share in (
                ("assumed: wires", known.wires), ("assumed: clock tree", known.clock_tree)) if row.unit == name)
            ends.append(self.sum_mj("dram", "sram", "leakage") + anchor * (self.sum_mj("dynamic", "clock") + grown))
        return ends[0], ends[1]

    def by_dram(self) -> dict[str, float]:
        """The energy of DRAM in mJ by what it is for; 0 where it is not counted."""
        found = dict.fromkeys(GROUPS, 0.0)
        for row in self.rows:
            if row.part == "dram":
                found[row.unit.removeprefix(DRAM_UNIT)] += row.value_mj
        return found

    def by_unit(self) -> dict[str, dict[str, float]]:
        """The energy in mJ by unit and part."""
        found: dict[str, dict[str, float]] = defaultdict(lambda: dict.fromkeys(PARTS, 0.0))
        for row in self.rows:
            found[row.unit][row.part] += row.value_mj
        return dict(found)

    def as_json(self) -> dict[str, object]:
        """The report as JSON-ready values."""
        entries = max(self.counts.entries, 1)
        return {
            "total_mj": self.total_mj, "chip_mj": self.chip_mj, "dram_mj": self.sum_mj("dram"),
            "assumed_mj": self.sum_mj("assumed"), "other_chip_mj": self.other_chip_mj, "range_mj": list(self.range_mj),
            "cycles": self.cycles, "clock_hz": self.clock_hz,
            "milliseconds": 1e3 * self.cycles / self.clock_hz, "frames_per_s": self.clock_hz / max(self.cycles, 1),
            "chip_mw": self.chip_mj * self.clock_hz / max(self.cycles, 1),
            "by_part_mj": {part: self.sum_mj(part) for part in PARTS}, "by_unit_mj": self.by_unit(),
            "by_dram_mj": self.by_dram(), "dram_not_counted": list(self.counts.not_counted),
            "pj_per_entry": {unit: sum(parts.values()) / PJ_TO_MJ / entries for unit, parts in self.by_unit().items()},
            "counts": asdict(self.counts), "rows": [asdict(row) for row in self.rows]}


def model_counts(trace: FrameTrace, cycles: FrameCycles) -> WorkCounts:
    """The operations of a frame from the cycle model. The commands of DRAM are known if LPDDR3 was simulated."""
    commands = {"activates": cycles.activates, "refreshes": cycles.refreshes} if cycles.activates else {}
    warped = trace.width * trace.height if len(trace.eyes) > 1 else 0
    covered = sum(int(eye.rendered.sum()) for eye in trace.eyes) / max(len(trace.eyes[0].rendered), 1)
    return WorkCounts(
        points=trace.points_read, survivors=sum(len(eye.survivor) for eye in trace.eyes), entries=cycles.entries,
        spilled_entries=cycles.spilled_entries, ops=cycles.ops, pixels=round(covered * trace.width * trace.height),
        warped=warped, tiles=sum(len(eye.counts) for eye in trace.eyes),
        read_beats=sum(cycles.reads.values()) // BEAT_BYTES, write_beats=sum(cycles.writes.values()) // BEAT_BYTES, **commands)


def counter_counts(frame: Mapping[str, object]) -> WorkCounts:
    """The operations of a frame through the RTL, from its counters in the frame.json of `python -m tb.frame`.

    The bench counts activates and refreshes where its memory is LPDDR3. Its ideal memory has none, so they are not known.
    """
    events, dram = frame["events"], frame["dram_bytes"]
    commands = {name: frame[name] for name in DRAM_COMMANDS} if frame.get("memory") == "lpddr3" else {}
    return WorkCounts(
        **{name: events.get(name, 0) for name in (
            "points", "survivors", "entries", "spilled_entries", "ops", "pixels", "warped")},
        tiles=frame["tiles"], read_beats=dram["read"] // BEAT_BYTES, write_beats=dram["write"] // BEAT_BYTES,
        **commands)


def frame_energy(
    counts: WorkCounts, cycles: int, config: AcceleratorConfig, table: Table, *, clock_hz: float = 1e9, dram: Dram = LPDDR3,
) -> EnergyReport:
    """The energy of a frame at 16 nm, and that of its memory.

    Args:
        counts: the frame's operations.
        cycles: the frame's length.
        config: the machine's configuration. Clock energy and leakage of a unit are scaled with its size relative to the
            table's. table: the energies of operations. clock_hz: the clock, which gives the time for leakage and standby. dram:
            the memory.

    Raises:
        ValueError: cycles or clock are not positive, or there are operations but no cycles.
    """
    if not isinstance(cycles, int) or cycles < 0 or (not cycles and counts != WorkCounts()):
        raise ValueError(f"cycles must be an integer, 1 or more where there is work, not {cycles!r}")
    if not clock_hz > 0:
        raise ValueError(f"clock_hz must be positive, not {clock_hz!r}")
    seconds, rows = cycles / clock_hz, []
    for unit in table.units:
        if unit.operation != "warped" or config.stereo:
            rows += _unit_rows(unit, counts, cycles, seconds, config, table)
    rows += _dram_rows(counts, seconds, dram)
    switching = table.to_16nm * sum(
        _work(unit, config, table) * unit.switching_pj * counts.of(unit.operation) for unit in table.units)
    clock = sum(row.value_mj for row in rows if row.part == "clock")
    known = estimates()
    rows.append(_assumed("wires", known.wires, switching, "pJ of nets", "that of the pins at their ends", table.scaling))
    rows.append(_assumed("clock tree", known.clock_tree, clock / PJ_TO_MJ, "pJ of clock pins",
                         "what the clock pins and the cells behind them take", table.scaling))
    return EnergyReport(tuple(rows), cycles, clock_hz, counts)


def _assumed(what: str, share: Share, pj: float, operation: str, of: str, scaling: str) -> EnergyRow:
    return EnergyRow(f"assumed: {what}", "assumed", share.value * pj * PJ_TO_MJ, pj, operation, share.value, "16 nm",
                     f"{share.value:.2f} of {of}, {share.low:.2f} to {share.high:.2f} by unit: reports/wires.json", scaling)


def _unit_rows(
    unit: Unit, counts: WorkCounts, cycles: int, seconds: float, config: AcceleratorConfig, table: Table,
) -> list[EnergyRow]:
    size, factor, done = _size(unit, config, table), table.to_16nm, counts.of(unit.operation)
    made = "16 nm", unit.source, f"{table.node}: {table.scaling}"
    leakage = factor * size * unit.leakage_mw  # leakage is scaled like energy, a simplification that matters little
    rows = [
        _row(unit.name, "dynamic", done, unit.operation, factor * _work(unit, config, table) * unit.dynamic_pj, *made),
        _row(unit.name, "clock", cycles, "cycles", factor * size * unit.clock_pj, *made),
        _row(unit.name, "leakage", seconds * 1e9, "ns", leakage, *made)]
    for m in configured(unit, config):
        access, kept = sram_access_pj(m.words, m.width), m.words * m.width * SRAM_LEAKAGE_SHARE * table.flop_leakage_pw * 1e-9
        rows.append(_row(
            unit.name, "sram", done * (m.reads + m.writes), f"accesses of {m.words} x {m.width}", access, "16 nm", SRAM_SOURCE,
            f"{SRAM_NODE}: {SRAM_SCALING}"))
        rows.append(_row(
            unit.name, "leakage", seconds * 1e9, "ns", factor * kept, "16 nm",
            f"{m.words} x {m.width} bits, each {SRAM_LEAKAGE_SHARE} of a flip-flop's", f"{table.node}: {table.scaling}"))
    return rows


def _row(unit: str, part: str, count: float, operation: str, pj: float, node: str, source: str, scaling: str) -> EnergyRow:
    return EnergyRow(unit, part, count * pj * PJ_TO_MJ, count, operation, pj, node, source, scaling)


def _size(unit: Unit, config: AcceleratorConfig, table: Table) -> float:
    if not unit.scales_with:
        return 1.0
    here = {"cores": config.cores_x * config.cores_y, "culling_units": config.culling_units, "warp_lanes": config.warp_lanes}
    return here[unit.scales_with] / table.reference[unit.scales_with]


def _work(unit: Unit, config: AcceleratorConfig, table: Table) -> float:
    """The work of an operation relative to the table's. An array with a quarter of the cores needs four operations where the
    measured one needs one, and each of them works a quarter of the cores."""
    return _size(unit, config, table) if unit.scales_with == "cores" else 1.0


def _dram_rows(counts: WorkCounts, seconds: float, dram: Dram) -> list[EnergyRow]:
    parts = dram.parts(seconds, counts.read_beats, counts.write_beats, counts.activates, counts.refreshes)
    return [_row(DRAM_UNIT + part.group, "dram", part.count, part.name, part.pj, dram.name, part.source, NOT_SCALED)
            for part in parts]
