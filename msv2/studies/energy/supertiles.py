"""The energy of frames on machines with lists by super-tile (`spec.supertiles`).

Units that only these machines have were measured on V3 (`Table.supertile_units`), and those that they share with other
machines on PAPER. Per operation the latter are the same, but some count another one: projection works once more for every pair,
and lists, sorter and handover move pairs instead of intersections. Two parts have no netlist of their own and are assumed: the
logic that loads and stores pixels' states, which costs nothing here, and the accesses to the memories that hold them. The
sources of the rows say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from msv2.studies.area.super_stores import super_stores
from msv2.studies.energy.frame import WorkCounts
from msv2.studies.energy.table import Memory, Table, Unit
from spec.config import V3, AcceleratorConfig
from spec.memory import BEAT_BYTES

if TYPE_CHECKING:  # a table must not need the model's compiler
    from perf.supertiles import SuperCycles
    from perf.supertiles_trace import SuperTrace

OPERATIONS = {
    "projection_unit": "projected", "tile_merge_unit": "pairs", "hierarchical_sorter": "sorted_entries", "line_buffer": "pairs",
    "list_reader": "pairs"}
"""Units that count another operation than on PAPER."""

DEALT = "dealt"
"""What the batch buffer counts: intersections of all streams, which on V3, where it was measured, are those of the frame."""

GONE = ("geometry_reader", "tile_test", "colour_unit", "entry_writer", "splat_fetch", "header_maker", "warp_unit")
"""PAPER's units that these machines do not have, or have another one in the place of."""

STAND_INS = {
    "supertile_test": ("tile_test", "tested"), "pair_colour": ("colour_unit", "pairs"),
    "chunk_test": ("projection_unit", "chunks"), "chunk_reader": ("geometry_reader", "points"),
    "chunk_header_reader": ("geometry_reader", "chunks"), "level_bounds": ("table_loader", "tiles"),
    "supertile_reader": ("header_maker", "tiles")}
"""Which one of PAPER's units stands for one that the table has no measurement of, with its operation."""

ASSUMED = {
    "transmittances": ("pixel_state", "state_rows", "assumed: each row of a tile's pixels is written once where it is stored, "
                       "and read once where it is loaded (rtl.vrc_array.pixel_state); its logic is not measured"),
    "sums": ("pixel_state", "state_rows", "as its transmittances"),
    "lists": ("queue of lists", "lists", "assumed: each list enters and leaves the queue once (rtl.top.gather_phase)")}
"""Memories that are in no measured netlist, each read and written once in an operation: unit, operation and source."""


@dataclass(frozen=True)
class SuperCounts(WorkCounts):
    """The operations of a frame.

    Attributes:
        pairs, places, visits: as the machine counts them. lists: the number of lists. chunks: that of the model's chunks, whose
            headers are tested.
        projected: Gaussians that pass projection: those that are read, and those of pairs.
        tests, tested: pairs, and intersections, that the tile test finds in both phases.
        state_rows: rows of pixels that are stored, and as many loaded.
        dealt: intersections that the batch buffer deals: with streams, those of each stream with its regions.

    With several streams `ops` counts an operation of one array as the share of the cores that it has. So the setup units and
    the rows, a few per cent of an operation's energy, count less often than they work.
    """

    pairs: int = 0
    places: int = 0
    visits: int = 0
    lists: int = 0
    chunks: int = 0
    projected: int = 0
    tests: int = 0
    tested: int = 0
    state_rows: int = 0
    dealt: int = 0

    def of(self, operation: str) -> int:
        """The number of a unit's operations: a field, or a sum of fields."""
        return self.pairs + self.spilled_entries if operation == "sorted_entries" else super().of(operation)


def super_counts(trace: SuperTrace, cycles: SuperCycles, config: AcceleratorConfig = V3) -> SuperCounts:
    """The operations of a frame from the cycle model. The commands of DRAM are known if LPDDR3 was simulated."""
    commands = {"activates": cycles.activates, "refreshes": cycles.refreshes} if cycles.activates else {}
    tiles = len(trace.counts)
    return SuperCounts(
        points=trace.points_read, survivors=trace.survivors, entries=cycles.entries, spilled_entries=cycles.spilled_entries,
        ops=cycles.ops // config.streams, pixels=trace.width * trace.height, tiles=tiles,
        read_beats=sum(cycles.reads.values()) // BEAT_BYTES, write_beats=sum(cycles.writes.values()) // BEAT_BYTES, **commands,
        pairs=cycles.pairs, places=int(trace.places.sum(dtype=np.int64)), visits=cycles.visits, lists=cycles.lists,
        chunks=len(trace.chunk_count), projected=trace.points_read + cycles.pairs, tests=2 * cycles.pairs,
        tested=2 * cycles.entries,
        state_rows=(cycles.visits - config.streams * tiles) * config.region**2 // config.array_x,
        dealt=sum(int((trace.regions >> stream & 1).sum(dtype=np.int64)) for stream in range(config.streams)))


def super_table(table: Table, config: AcceleratorConfig = V3) -> Table:
    """The table of energies for a machine with super-tiles, with what was measured and assumed for it. Where a machine packs
    frames, the frame is packed."""
    units = [replace(unit, operation=OPERATIONS.get(unit.name, unit.operation), source=_shared(unit))
             for unit in table.units if unit.name not in GONE]
    own = [replace(unit, operation=DEALT) if unit.name == "batch_buffer" else unit for unit in table.supertile_units
           if unit.name not in _other_units(table, config)]
    if config.packed and any(unit.name == "frame_packer" for unit in own):
        units = [_resting(unit) if unit.name == "pixel_writer" else unit for unit in units]
    return replace(table, units=(*units, *own, *_stand_ins(table), *_assumed(config)))


def _other_units(table: Table, config: AcceleratorConfig) -> set[str]:
    """The measured units that a machine does not have. Without a measurement of the buffer of several streams, that of one
    stands for it."""
    gone = set() if config.packed else {"frame_packer"}
    streamed = config.streams > 1 and any(unit.name == "stream_buffer" for unit in table.supertile_units)
    return gone | {"batch_buffer" if streamed else "stream_buffer"}


def _resting(unit: Unit) -> Unit:
    """A unit that does nothing: its clock and its leakage stay."""
    return replace(unit, dynamic_pj=0.0, switching_pj=0.0, memories=(), source=f"{unit.source}; it rests in packed frames")


def _stand_ins(table: Table) -> list[Unit]:
    """The units of STAND_INS that were not measured."""
    measured, of = {unit.name for unit in table.supertile_units}, {unit.name: unit for unit in table.units}
    return [replace(of[name], name=unit, operation=operation,
                    source=f"assumed: not measured; {name} of PAPER stands for it, with {of[name].operation} as {operation}. "
                           f"That is by {of[name].source}")
            for unit, (name, operation) in STAND_INS.items() if unit not in measured]


def _shared(unit: Unit) -> str:
    """The source of a unit that was measured on PAPER."""
    here = OPERATIONS.get(unit.name, unit.operation)
    other = f", where it counts {unit.operation} in place of {here}" if here != unit.operation else ""
    return f"{unit.source}; on PAPER{other}"


def _assumed(config: AcceleratorConfig) -> list[Unit]:
    """The memories of ASSUMED, a unit for each."""
    units = []
    for store in super_stores(config):
        of, operation, source = ASSUMED.get(store.name, ("", "", ""))
        if store.unit == of:
            memories = (Memory(store.words, store.width, 1 / store.count, 1 / store.count),) * store.count
            units.append(Unit(f"{store.unit}: {store.name}", operation, 0.0, 0.0, 0.0, 0.0, memories, source))
    return units
