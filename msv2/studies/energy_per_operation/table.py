"""Converts measurements to the table that `msv2.studies.energy.frame` reads. It takes means over scenes, splits the array into
parts, and adds the units that no test bench plays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from spec.chunks import TEST_INTERVAL
from spec.config import PAPER

OPERATIONS = {
    "projection_unit": "points", "tile_test": "entries", "colour_unit": "survivors", "tile_merge_unit": "entries",
    "hierarchical_sorter": "sorted_entries", "line_buffer": "entries", "splat_fetch": "entries", "setup": "ops",
    "vrc_array": "ops", "pixel_writer": "pixels"}
"""For each simulated unit, the count of a frame (`msv2.studies.energy.frame.WorkCounts`) that its operations are."""

DEFAULTS = {
    "geometry_reader": ("points", 1), "table_loader": ("tiles", 1), "entry_writer": ("entries", 1),
    "list_reader": ("entries", 1), "header_maker": ("tiles", 1), "axi_master": ("beats", 1), "register_file": ("cycles", 1),
    "frame_controller": ("cycles", 1), "warp_unit": ("warped", 1 / PAPER.warp_lanes)}
"""For each unit that is not simulated, the count that its operations are, and how many cycles an operation takes."""

SUPER_OPERATIONS = {"supertile_test": "tests", "record_fetch": "pairs", "pair_colour": "pairs", "batch_buffer": "entries",
                    "stream_buffer": "dealt", "frame_packer": "pixels"}
"""The same for the simulated units that only machines with lists by super-tile have: counts of
`msv2.studies.energy.supertiles.SuperCounts`."""

SUPER_DEFAULTS = {
    "chunk_header_reader": ("chunks", 1), "level_bounds": ("tiles", 1), "chunk_test": ("chunks", TEST_INTERVAL),
    "chunk_reader": ("points", 1), "supertile_clip": ("tests", 1), "depth_buckets": ("pairs", 1), "pair_writer": ("pairs", 1),
    "supertile_reader": ("tiles", 1)}
"""The same for those that are not simulated, with those that any machine with chunks has."""

ARRAY_PARTS = {"pixel_core": "pixel cores", "vrc_row": "array rows", "vrc_array": "array control and output"}
"""The modules of the array that have rows of their own."""

SIZED = {"pixel cores": "cores", "array rows": "cores", "projection_unit": "culling_units", "colour_unit": "culling_units",
         "tile_test": "culling_units", "warp_unit": "warp_lanes", "supertile_test": "culling_units",
         "pair_colour": "culling_units"}
"""For each unit whose clock energy and leakage scale with a field of the configuration, that field."""

GATES = "gate-level simulation with delays, {scenes}; every output equal to golden"
SETUP = "gate-level simulation with delays, {scenes}; every output equal to the RTL's"
ARRAY = "gate-level simulation of the whole array with delays, {scenes}; every pixel equal to golden"
DEFAULT = "clock and leakage of its netlist; activity: mean of the simulated units by area; memories work in every cycle"


def unit_rows(rows: Sequence[dict]) -> list[dict[str, object]]:
    """The units of the machine, each with the fields of `msv2.studies.energy.table.Unit`."""
    units = []
    for unit, operation in OPERATIONS.items():
        samples = [row for row in rows if row["unit"] == unit]
        scenes = ", ".join(row["scene"] for row in samples)
        if unit == "vrc_array":
            for part, name in ARRAY_PARTS.items():
                parts = [row["parts"][part] for row in samples]
                memories = samples if part == "vrc_array" else []
                units.append(_unit(name, operation, parts, memories, ARRAY.format(scenes=scenes)))
        else:
            units.append(_unit(unit, operation, samples, samples, (SETUP if unit == "setup" else GATES).format(scenes=scenes)))
    _take_setup_out(units)
    return [*units, *_default_units(rows, DEFAULTS, default_activity(rows))]


def super_unit_rows(rows: Sequence[dict], of_paper: Sequence[dict]) -> list[dict[str, object]]:
    """The units that only machines with lists by super-tile have, less those that were left out. `of_paper` are the rows of
    PAPER's units, whose mean activity is that of units that no test bench plays."""
    units = []
    for unit, operation in SUPER_OPERATIONS.items():
        samples = [row for row in rows if row["unit"] == unit]
        scenes = ", ".join(row["scene"] for row in samples)
        if samples:
            units.append(_unit(unit, operation, samples, samples, GATES.format(scenes=scenes)))
    return [*units, *_default_units(rows, SUPER_DEFAULTS, default_activity(of_paper))]


def _default_units(
    rows: Sequence[dict], operations: Mapping[str, tuple[str, float]], activity: tuple[float, float],
) -> Iterator[dict[str, object]]:
    """The units whose clock energy and leakage alone were measured."""
    rate, nets = activity
    for row in rows:
        if row["unit"] in operations:
            operation, cycles = operations[row["unit"]]
            dynamic = rate * row["area_um2"] * cycles
            yield {
                "name": row["unit"], "operation": operation, "dynamic_pj": round(dynamic, 5),
                "switching_pj": round(nets * dynamic, 5), "clock_pj": row["clock_pj_per_cycle"],
                "leakage_mw": row["leakage_mw"],
                "memories": [{**memory, "reads": cycles, "writes": cycles} for memory in row["memories"]],
                "source": DEFAULT, "scales_with": SIZED.get(row["unit"], "")}


def default_activity(rows: Sequence[dict]) -> tuple[float, float]:
    """The mean over the simulated units but the array of pJ per cycle and um^2, and the share of it that nets take."""
    found = [(row["pj_per_operation"] * row["operations"] / row["cycles"] / row["area_um2"],
              row["switching_pj_per_operation"] / row["pj_per_operation"])
             for row in rows if "operation" in row and row["unit"] != "vrc_array"]
    rate, nets = np.mean(found, axis=0)
    return float(rate), float(nets)


def _unit(name: str, operation: str, samples: Sequence[dict], with_memories: Sequence[dict], source: str) -> dict[str, object]:
    def mean(key: str) -> float:
        return round(float(np.mean([sample[key] for sample in samples])), 6)

    memories = [
        {"words": same[0]["words"], "width": same[0]["width"],
         "reads": round(float(np.mean([memory["reads_per_operation"] for memory in same])), 5),
         "writes": round(float(np.mean([memory["writes_per_operation"] for memory in same])), 5)}
        for same in zip(*(sample["memories"] for sample in with_memories), strict=True)]
    return {"name": name, "operation": operation, "dynamic_pj": mean("pj_per_operation"),
            "switching_pj": mean("switching_pj_per_operation"), "clock_pj": mean("clock_pj_per_cycle"),
            "leakage_mw": mean("leakage_mw"), "memories": memories, "source": source, "scales_with": SIZED.get(name, "")}


def _take_setup_out(units: list[dict[str, object]]) -> None:
    """Subtracts the setup unit, which has a row of its own, from the array's module, which contains it."""
    by_name = {unit["name"]: unit for unit in units}
    rest, setup = by_name["array control and output"], by_name["setup"]
    for key in ("dynamic_pj", "switching_pj", "clock_pj", "leakage_mw"):
        rest[key] = round(rest[key] - setup[key], 6)
