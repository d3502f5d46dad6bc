"""The energy of frames on machines with lists by super-tile (`spec.supertiles`).

The logic of shared units was measured on PAPER, per operation. Here, projection, tile test and colours work once more for every
pair; lists, sorter and handover move pairs instead of intersections; and units for splat records and headers of tiles are gone.
Memories that only these machines have are counted by access. The logic of their new units is not measured: its work for a pair
is taken as that of the splat fetch unit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from msv2.studies.area.super_stores import super_stores
from msv2.studies.energy.frame import WorkCounts
from msv2.studies.energy.table import Memory, Table, Unit
from perf.supertiles import SuperCycles
from perf.supertiles_trace import SuperTrace
from spec.config import V3, AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BYTES, colour_beats

_OPERATIONS = {
    "projection_unit": "projected", "tile_test": "tested", "colour_unit": "pairs", "tile_merge_unit": "pairs",
    "hierarchical_sorter": "sorted_entries", "line_buffer": "pairs", "entry_writer": "pairs", "list_reader": "pairs"}
"""Units that count another operation than on PAPER."""

_GONE = ("header_maker", "warp_unit")

_SOURCE = "accesses of an operation by the unit's design (rtl/supertiles)"


@dataclass(frozen=True)
class SuperCounts(WorkCounts):
    """The operations of a frame.

    Attributes:
        pairs, places, visits: as the machine counts them.
        projected: Gaussians that pass projection: those that are read, and those of pairs.
        tested: intersections that the tile test finds in both phases.
        state_rows: rows of pixels that are stored, and as many loaded.
    """

    pairs: int = 0
    places: int = 0
    visits: int = 0
    projected: int = 0
    tested: int = 0
    state_rows: int = 0

    def of(self, operation: str) -> int:
        """The number of a unit's operations: a field, or a sum of fields."""
        return self.pairs + self.spilled_entries if operation == "sorted_entries" else super().of(operation)


def super_counts(trace: SuperTrace, cycles: SuperCycles, config: AcceleratorConfig = V3) -> SuperCounts:
    """The operations of a frame from the cycle model. The commands of DRAM are known if LPDDR3 was simulated."""
    commands = {"activates": cycles.activates, "refreshes": cycles.refreshes} if cycles.activates else {}
    tiles = len(trace.counts)
    return SuperCounts(
        points=trace.points_read, survivors=trace.survivors, entries=cycles.entries, spilled_entries=cycles.spilled_entries,
        ops=cycles.ops, pixels=trace.width * trace.height, tiles=tiles,
        read_beats=sum(cycles.reads.values()) // BEAT_BYTES, write_beats=sum(cycles.writes.values()) // BEAT_BYTES, **commands,
        pairs=cycles.pairs, places=int(trace.places.sum(dtype=np.int64)), visits=cycles.visits,
        projected=trace.points_read + cycles.pairs, tested=2 * cycles.entries,
        state_rows=(cycles.visits - tiles) * TILE * TILE // config.cores_x)


def super_table(table: Table, trace: SuperTrace, config: AcceleratorConfig = V3) -> Table:
    """The table of energies for a machine with super-tiles, from that of PAPER."""
    units = []
    for unit in table.units:
        if unit.name == "splat_fetch":
            units.append(replace(unit, name="record_fetch", operation="pairs", memories=(), source=_SOURCE))
        elif unit.name not in _GONE:
            units.append(replace(unit, operation=_OPERATIONS.get(unit.name, unit.operation)))
    return replace(table, units=(*units, *_memories(config, colour_beats(config, trace.sh_degree))))


def _memories(config: AcceleratorConfig, beats: int) -> list[Unit]:
    """The memories that only machines with super-tiles have, a unit for each operation."""
    accesses = {
        "tags": ("pairs", 1.0, 1.0), "located": ("pairs", 1.0, 1.0), "awaited": ("pairs", 1.0, 1.0),
        "places of chunks": ("pairs", 1.0, 0.05), "shapes of chunks": ("pairs", 1.0, 0.05), "missed": ("pairs", 0.05, 0.05),
        "beats": ("pairs", float(beats), float(beats)), "bounds": ("pairs", 1.0, 0.0), "pairs": ("pairs", 1.0, 1.0),
        "records": ("places", 0.0, 1.0), "masks": ("visits", 2.0, 2.0), "supertiles": ("visits", 0.1, 0.1),
        "transmittances": ("state_rows", 1.0, 1.0), "sums": ("state_rows", 1.0, 1.0)}
    units = []
    for store in super_stores(config):
        if store.name not in accesses:
            continue
        operation, reads, writes = accesses[store.name]
        memory = Memory(store.words, store.width, reads, writes)
        units.append(Unit(f"{store.unit}: {store.name}", operation, 0.0, 0.0, 0.0, 0.0, (memory,) * store.count, _SOURCE))
        if store.name == "records":  # each intersection reads its record
            read = replace(memory, reads=1.0, writes=0.0)
            units.append(Unit(f"{store.unit}: entries", "entries", 0.0, 0.0, 0.0, 0.0, (read,), _SOURCE))
    return units
