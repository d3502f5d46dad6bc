"""The area of any configuration: that of a synthesised build where there is one, else an estimate from the unit tables.

    area = estimate_area(config)
    area.mm2, area.synthesised, area.groups["sorting and tile merging"].memory_um2

An estimate begins with PAPER's build of reports/area.json, with or without the warp unit, or for lists by super-tile with the
build `v3`. The logic of a group is scaled by what the configuration changes in it (`_logic`). Machines with chunks and lists
by tile get the logic that reads and tests chunks from the build `v3` (`_chunk_units`), and machines that pack frames the
frame packer as it was synthesised alone. Memories are taken from the table of
shapes (`msv2.studies.area.stores`) and built of macros as in synthesis (`synth.macros`), so that a larger cache costs the
area of its lines and tags. With several streams, what every array has of its own counts as often: setup, sequencer, rows,
collection and blending; their batch buffer and the join of their rows are the units that were synthesised alone. What the tile
test adds is left out: some hundred flip-flops. With joint frames or overlapped phases, the units of `msv2.studies.area.eyes`
are larger, or new. For PAPER with the presets' formats, which was synthesised, the estimate is within 1 % of the builds
(tests/msv2/studies/area/test_estimate.py). Areas are in um^2 at 16 nm.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

from msv2.studies.area.replaced import SUPERTILE_LISTS
from msv2.studies.area.stores import stores
from spec.config import PAPER, PRESETS, V3, AcceleratorConfig, NumberFormats
from spec.errors import InputError
from spec.paths import REPORTS
from synth.machine import ARRAY, BLENDING, COLOUR, CONTROL, CULLING, GROUPS, LISTS, SORTING, WARP
from synth.macros import FLOP_UM2, MUX_UM2, make
from synth.memories import Macro
from synth.scaling import TO_16NM

REPORT, CULLING_REPORT, SYNTHESIS_REPORT, REPORT_OF_EYES = (
    REPORTS / f"{name}.json" for name in ("area", "culling_area", "synthesis", "area_eyes"))

SHORTENED = {
    name: PAPER.with_(name=name, formats=config.formats, sh_degree=config.sh_degree) for name, config in PRESETS.items()}
"""PAPER with the formats and the SH degree of each preset, by the preset's name."""

BUILDS = {"mono": PAPER, "1ghz": PAPER.with_(stereo=True), SUPERTILE_LISTS: V3, **SHORTENED}
"""The builds of the area report at 1 GHz in ASAP7, and their machines."""

SYNTHESISED, ESTIMATE = "synthesised", "estimate"
"""Where a number comes from: the report of a synthesised build, or scaling from one."""

NO_AREA = ("name", "support_sigma", "warp_fill", "warp_veiled")
"""Fields without an area: constants of a register or of a comparison, whose width does not depend on them."""

_TESTING, _READING = ("geometry.bounds", "geometry.chunk_test"), ("geometry.headers", "geometry.reader", "queue_chunks")
"""Units of chunks in the group of culling and in that of lists."""

JOINT, OVERLAP = "joint", "overlap"
"""The fields whose units are in reports/area_eyes.json."""

_TO_16NM = TO_16NM["asap7"].area
_OPERATORS_OF_WORK = 0.8
"""Share of the culling operators that are of the `work` format; the others are of `view`."""


@dataclass(frozen=True)
class GroupArea:
    """The area of a group of units, in um^2 at 16 nm."""

    logic_um2: float
    memory_um2: float


@dataclass(frozen=True)
class AreaEstimate:
    """The area of a machine.

    Attributes:
        groups: by the names of `synth.machine.GROUPS`.
        basis: SYNTHESISED or ESTIMATE.
        build: the synthesised build that the numbers are of, or from which they are scaled.
    """

    groups: dict[str, GroupArea]
    basis: str
    build: str

    @property
    def synthesised(self) -> bool:
        return self.basis == SYNTHESISED

    @property
    def logic_mm2(self) -> float:
        """Area of all logic."""
        return sum(group.logic_um2 for group in self.groups.values()) / 1e6

    @property
    def memory_mm2(self) -> float:
        """Area of all memories."""
        return sum(group.memory_um2 for group in self.groups.values()) / 1e6

    @property
    def mm2(self) -> float:
        """Area of the machine in mm^2 at 16 nm."""
        return self.logic_mm2 + self.memory_mm2


@cache
def _report(name: str) -> dict:
    path = {"area": REPORT, "culling": CULLING_REPORT, "synthesis": SYNTHESIS_REPORT, "eyes": REPORT_OF_EYES}[name]
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a report of areas ({error}): see `msv2 study list --reports`") from error


def estimate_area(config: AcceleratorConfig, eyes: Iterable[Mapping[str, Any]] | None = None) -> AreaEstimate:
    """The area of a machine.

    Args:
        config: the machine.
        eyes: the rows of reports/area_eyes.json; None for those that are there.

    Raises:
        InputError: a report of synthesis is missing.
    """
    for name, build in BUILDS.items():
        if all(getattr(config, f.name) == getattr(build, f.name) for f in fields(config) if f.name not in NO_AREA):
            return AreaEstimate(_of_build(name), SYNTHESISED, name)
    name = SUPERTILE_LISTS if config.supertiles else "1ghz" if config.stereo else "mono"
    build = BUILDS[name]
    base, here, there = _of_build(name), _memories(config), _memories(build)
    chunks = _chunk_units() if config.chunks and not config.supertiles else {}
    packer = {LISTS: _synthesised_um2("frame_packer") * _TO_16NM} if config.packed else {}
    has = {JOINT: config.joint, OVERLAP: config.overlap}
    more = _of_fields(_report("eyes")["rows"] if eyes is None else eyes, has) if any(has.values()) else {}
    second = {CULLING: _unit_um2("geometry.path.tile_test"), CONTROL: _unit_um2("registers")} if config.overlap else {}
    added = (chunks, packer, more, second)
    groups = {
        group: GroupArea(base[group].logic_um2 * _logic(group, config, build) + sum(more.get(group, 0.0) for more in added),
                         max(0.0, base[group].memory_um2 + here.get(group, 0.0) - there.get(group, 0.0)))
        for group in base}
    return AreaEstimate(groups, ESTIMATE, name)


def _of_fields(rows: Iterable[Mapping[str, Any]], has: Mapping[str, bool]) -> dict[str, float]:
    """Logic that joint frames and overlapped phases add to a group, in um^2 at 16 nm: of what was synthesised alone
    (`msv2.studies.area.eyes`). `has` says which of these fields a machine has."""
    found: dict[str, float] = {}
    for row in rows:
        if has[row["field"]]:
            found[row["group"]] = found.get(row["group"], 0.0) + row["added_um2"] * _TO_16NM
    return found


def _unit_um2(unit: str) -> float:
    """The logic of a unit of the build `v3`, in um^2 at 16 nm. With overlapped phases, a second tile test counts whole,
    although both phases share its datapath, and a second register file for the settings and counts of the second frame."""
    return next(row["logic_um2_16nm"] for row in _report("area")["builds"][SUPERTILE_LISTS]["units"] if row["unit"] == unit)


def _of_build(name: str) -> dict[str, GroupArea]:
    found = _report("area")["builds"][name]["groups"]
    return {group: GroupArea(found[group]["logic_um2_16nm"], found[group]["memory_um2_16nm"])
            for group in GROUPS if group in found}


def _memories(config: AcceleratorConfig) -> dict[str, float]:
    """Area of the memories by group."""
    found: dict[str, float] = {}
    for store in stores(config):
        found[store.group] = found.get(store.group, 0.0) + store.count * _memory_um2(store.words, store.width)
    return found


@cache
def _memory_um2(words: int, width: int) -> float:
    return make(Macro(words, width, 1, 1)).area_um2 * _TO_16NM


def _logic(group: str, config: AcceleratorConfig, build: AcceleratorConfig) -> float:
    """The logic of a group relative to that of the build."""
    scale = {ARRAY: _array, BLENDING: _blending, CULLING: _culling, COLOUR: _colour, SORTING: _sorting, CONTROL: _control,
             WARP: _warp}.get(group)
    return scale(config) / scale(build) if scale else 1.0


def _chunk_units() -> dict[str, float]:
    """Logic that chunks add to a group, in um^2 at 16 nm: the units of the build `v3`, less the reader in whose place they are.

    The decoding of compact records is in them, so that a machine with chunks of wide records has somewhat less.
    """
    units = {row["unit"]: row["logic_um2_16nm"] for row in _report("area")["builds"][SUPERTILE_LISTS]["units"]}
    return {CULLING: sum(units[unit] for unit in _TESTING),
            LISTS: sum(units[unit] for unit in _READING) - _row("geometry.reader")["logic_um2_16nm"]}


def _synthesised_um2(unit: str) -> float:
    """The area of a unit that was synthesised alone, in um^2 of its technology."""
    return next(row["area_um2"] for row in _report("synthesis")["rows"] if row["unit"] == unit)


def _row(unit: str) -> Mapping[str, object]:
    return next(row for row in _report("area")["rows"] if row["unit"] == unit)


def _pixel_bits(config: AcceleratorConfig) -> int:
    """Bits that a core holds of one pixel at one level: colour sums, depth sum and transmittance."""
    n = config.formats
    return 3 * n.accumulator.width + (n.depth_accumulator.width if config.depth else 0) + n.transmittance.width


def _core_bits(config: AcceleratorConfig) -> float:
    """Widths of a core's arithmetic: exponent and its differences, alpha, weights and sums."""
    n = config.formats
    exponent = 2 * n.exponent.width + n.slope.width + n.curvature.width
    weights = n.transmittance.width + n.alpha.width + n.weight.width + n.exp2_segments / 2
    sums = 3 * (n.accumulator.width + n.colour.width * n.weight.width / 4)
    depth = n.depth_accumulator.width + n.depth.width * config.depth_weight.width / 4 if config.depth else 0
    return exponent + weights + sums + depth


def _banks(config: AcceleratorConfig) -> float:
    """The banks of a core in um^2: registers, or memories with a register behind each bit that is read."""
    bits = _pixel_bits(config)
    if not config.bank_memories:
        return config.banks * bits * (FLOP_UM2 + MUX_UM2)
    return config.level_banks * bits * FLOP_UM2 + make(Macro(config.blocks, config.level_banks * bits, 1, 1)).area_um2


def _array(config: AcceleratorConfig) -> float:
    """Cores with their banks of sums, rows, and what does not depend on the array's size."""
    parts = _row("render.array")["parts"]
    core, row = parts["pixel_core"]["area"], parts["vrc_row"]["area"]
    held = BUILDS["1ghz"]
    more = _banks(config) - _banks(held)
    cores, rows = config.cores_x * config.cores_y, config.streams * config.array_y
    rest = _row("render.array")["logic_um2"] - parts["pixel_core"]["count"] * core - parts["vrc_row"]["count"] * row
    around = sum(_row(f"render.array.{name}")["logic_um2"] for name in ("setup", "sequencer"))
    expand = _row("render.array.expand")["logic_um2"] * config.streams * config.array_x / held.cores_x
    return (cores * (core * _core_bits(config) / _core_bits(held) + more) + rows * row
            + rest * cores / (held.cores_x * held.cores_y) + config.streams * around + expand)


def _blending(config: AcceleratorConfig) -> float:
    """The rows' collection, the unit that blends two levels where there are two, and with super-tiles the batch buffer and the
    pixels' state."""
    blend = _synthesised_um2("blend")
    collect = _row("render.array.collect")["logic_um2"] - blend
    size = config.streams * config.array_x / PAPER.cores_x * _pixel_bits(config) / _pixel_bits(PAPER)
    kept = 0.0
    if config.supertiles:
        units = {row["unit"]: row["logic_um2"] for row in _report("area")["builds"][SUPERTILE_LISTS]["units"]}
        batches = units["render.batches"]
        if config.streams > 1:
            batches = _synthesised_um2("stream_buffer") + _synthesised_um2("row_join")
        kept = batches + size * units["render.array.state"]
    return size * (collect * (1 + config.level_banks) / 3 + (blend if config.level_banks == 2 else 0)) + kept


def _shared(part: str, config: AcceleratorConfig) -> float:
    """Area of one culling or colour unit, as synthesised at the rate that `culling_units` gives it."""
    rows = [row for row in _report("culling")["rows"] if row["part"] == part]
    row = next(row for row in rows if row["units"] == PAPER.culling_units // config.culling_units)
    return row["area_um2"] / row["units"]


def _culling(config: AcceleratorConfig) -> float:
    n, usual = config.formats, NumberFormats()
    bits = (_OPERATORS_OF_WORK * n.work.sig_bits / usual.work.sig_bits
            + (1 - _OPERATORS_OF_WORK) * n.view.sig_bits / usual.view.sig_bits)
    return bits * _shared("projection_unit", config)


def _colour(config: AcceleratorConfig) -> float:
    builds, n, usual = _report("area")["builds"], config.formats, NumberFormats()
    by_degree = {degree: builds[name]["groups"][COLOUR]["logic_um2"]
                 for degree, name in ((3, "precise"), (2, "balanced"), (1, "fast"))}
    by_degree[0] = by_degree[1] ** 2 / by_degree[2]  # no machine of degree 0 was synthesised: the ratio goes on
    bits = (n.sh_basis.width + n.sh_rest.width) / (usual.sh_basis.width + usual.sh_rest.width)
    return by_degree[config.sh_degree] * bits * _shared("colour_unit", config)


def _sorting(config: AcceleratorConfig) -> float:
    """Stages of the chunk sorter, ways of the merge tree, and what does not depend on either."""
    stages = (config.sort_chunk.bit_length() - 1) / (PAPER.sort_chunk.bit_length() - 1)
    ways = config.merge_ways / PAPER.merge_ways
    sorter, tree = _row("render.sorter.sorter")["logic_um2"], sum(
        _row(f"render.sorter.{name}")["logic_um2"] for name in ("reader", "tree"))
    group = sum(row["logic_um2"] for row in _report("area")["rows"] if row["group"] == SORTING)
    return sorter * stages + tree * ways + group - sorter - tree


def _control(config: AcceleratorConfig) -> float:
    group = sum(row["logic_um2"] for row in _report("area")["rows"] if row["group"] == CONTROL)
    return group - (0 if config.counters else _row("counters")["logic_um2"])


def _warp(config: AcceleratorConfig) -> float:
    parts = _row("render.warp")["parts"].values()
    lanes = sum(part["count"] * part["area"] for part in parts)
    group = sum(row["logic_um2"] for row in _report("area")["rows"] if row["group"] == WARP)
    return lanes * config.warp_lanes / PAPER.warp_lanes + group - lanes
