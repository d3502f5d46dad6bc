"""All proofs, and the components of rtl/ that have none, with the reason."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

from amaranth.lib import wiring

import rtl
from msv2.cases.formal.proof import Proof
from msv2.cases.formal.units import axi, datapath, general, sorting, streams
from spec.command_line import choice

PROOFS: tuple[Proof, ...] = (*streams.PROOFS, *axi.PROOFS, *sorting.PROOFS, *general.PROOFS, *datapath.PROOFS)

PARTS = "its parts have proofs; the whole is compared with the golden renderer, frame by frame"
WITHIN = "a part of a unit that is proven as a whole"
NUMBERS = "it has no streams; its numbers are compared with the golden renderer's"

SIDE = "it belongs to the system for an FPGA; random accesses and frames are played through it"

LONG = "the proof ends, but an item takes so many cycles through it that none was seen to leave in the proof's time"

UNPROVEN: dict[str, str] = {
    "Machine": PARTS, "BinPhase": PARTS, "GatherPhase": PARTS, "GeometryPhase": PARTS, "RenderPhase": PARTS,
    "FramePacker": PARTS, "FrameWriter": PARTS, "SplatPath": PARTS, "StreamBuffer": PARTS, "SuperTileTest": PARTS,
    "TileTest": PARTS, "WarpUnit": PARTS,
    "RecordFetch": "its queues are too long for a proof; the cache in it has one",
    "ListReplay": "its answers come from a memory elsewhere, which no bench states yet",
    "SweepTurns": "the queues in it are a library's; what it makes of items is compared with plain Python",
    "HoleTiles": "it has no stream", "StripWarp": PARTS, "WarpStrips": PARTS, "KnownPack": WITHIN,
    "Window": "its inputs keep rules of the warp unit that no bench states yet",
    "ListSets": PARTS, "SplatPaths": PARTS, "PhaseTileTest": PARTS, "System": PARTS,
    "MemoryBridge": SIDE, "RegisterBridge": SIDE, "Sender": SIDE,
    "VrcArray": PARTS, "BatchArray": PARTS, "HierarchicalSorter": PARTS, "StreamArrays": PARTS,
    "BatchMasks": WITHIN, "BlockSequencer": WITHIN, "BatchSequencer": WITHIN, "BoundsMaker": WITHIN, "ChunkWalk": WITHIN,
    "ColourSum": WITHIN, "CompactColourSum": WITHIN, "CompactRecordWriter": WITHIN, "Datapath": WITHIN,
    "SharedDatapath": WITHIN, "PairPlaces": WITHIN,
    "RecordWriter": WITHIN, "SuperLevelTable": WITHIN, "LevelTable": WITHIN, "_Place": WITHIN,
    "ChunkTest": LONG, "Projection": LONG, "ProjectionUnit": LONG,
    "Expand": NUMBERS, "Blend": NUMBERS, "BlendWeights": NUMBERS, "PixelCore": NUMBERS, "VrcRow": NUMBERS, "BatchCore": NUMBERS,
    "MemoryCore": NUMBERS, "MemoryRow": NUMBERS, "KeptCounts": NUMBERS,
    "BatchRow": NUMBERS, "LevelBounds": NUMBERS, "SaturationCounters": NUMBERS, "PerformanceCounters": NUMBERS,
    "StageCounters": NUMBERS, "Disparity": NUMBERS, "Divider": NUMBERS, "RingBank": NUMBERS, "RowQueue": NUMBERS,
    "FloatUnit": "the base class of the operators", "_Root": "the base class of the roots",
    "Iteration": "the base class of the operators that iterate",
}
"""Components without a proof, by the name of their class."""


def components() -> dict[str, type[wiring.Component]]:
    """Every component of rtl/, by the name of its class."""
    for module in pkgutil.walk_packages(rtl.__path__, "rtl."):
        importlib.import_module(module.name)
    return {kind.__name__: kind for kind in sorted(_below(wiring.Component), key=lambda kind: kind.__name__)
            if kind.__module__.startswith("rtl.")}


def _below(kind: type) -> Iterator[type]:
    for each in kind.__subclasses__():
        yield each
        yield from _below(each)


def unexplained() -> list[str]:
    """Components that neither have a proof nor a reason why they have none."""
    proven = {proof.unit.__name__ for proof in PROOFS}
    return [name for name in components() if name not in proven and name not in UNPROVEN]


def named(unit: str) -> tuple[Proof, ...]:
    """The proofs of a component by the name of its class; InputError with what is accepted, and the nearest name."""
    names = {proof.unit.__name__ for proof in PROOFS}
    wanted = choice("unit", unit, sorted(names))
    return tuple(proof for proof in PROOFS if proof.unit.__name__ == wanted)
