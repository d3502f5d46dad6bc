"""What synthesis knows of units besides `rtl.units`: the configurations that are reported, and hints for carry chains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtl.units import TOP, UNITS
from spec.config import PAPER, PAPER_SMALL, V3, V3_STREAMS, AcceleratorConfig

SYNTHESISED = tuple(name for name in UNITS if name != TOP)
"""Units that are synthesised by their names. The whole machine is synthesised unit by unit (`synth.area`)."""

_OF_PAPER_SMALL = ("pixel_core", "vrc_row")

_OF_SUPERTILES = (
    "chunk_header_reader", "chunk_reader", "geometry_decode", "level_bounds", "chunk_test", "supertile_clip", "supertile_test",
    "pair_colour", "depth_buckets", "pair_writer", "supertile_reader", "record_fetch", "batch_buffer", "batch_array")
"""Units that only machines with chunks or with lists by super-tile have."""

_OF_STREAMS = ("stream_buffer", "row_join", "stream_arrays")
"""Units that only machines with several streams have."""

_CULLING = {f"culling_units={units}": PAPER.with_(culling_units=units) for units in (4, 2, 1)}

VARIANTS: dict[str, Mapping[str, AcceleratorConfig]] = {
    "pixel_core": {
        "levels=1": PAPER_SMALL.with_(levels=1), "depth=False": PAPER_SMALL.with_(depth=False),
        "levels=1, depth=False": PAPER_SMALL.with_(levels=1, depth=False)},
    "projection_unit": _CULLING,
    "colour_unit": _CULLING,
    "supertile_test": {f"streams={V3_STREAMS.streams}": V3_STREAMS},
    "warp_unit": {f"warp_lanes={lanes}": PAPER.with_(warp_lanes=lanes) for lanes in (2, 1)},
}
"""Further configurations that a unit is reported for, by name."""

BLOCKS: dict[str, Mapping[str, Sequence[int]]] = {
    "pixel_core": {"after": (4, 4, 5), "less": (4,), "total0": (5,), "total1": (5,), "total2": (5,), "total3": (6, 5),
                   "exponent_below": (6,)},
    "vrc_row": {},
}
"""Incremented blocks at the top of a sum's carry chain, lowest first, by unit and by the name of the sum (`synth.heap`).

They were found by lengthening the chain of the worst path until 1,000 ps were met; a name that no sum bears is ignored. The
blocks of all other units are chosen from the slack (`synth.report`).
"""


RESERVED_PS: dict[str, float] = {f"{TOP}__render__sorter__sorter": 45.0, f"{TOP}__geometry__writer": 45.0}
"""Time that a module must leave free in ASAP7 where it is mapped for a machine, because its largest memory is of so many macros
that their pins take longer than is assumed of a module by itself."""


def config_of(unit: str) -> AcceleratorConfig:
    """The configuration that a unit is reported for."""
    of_units = {_OF_PAPER_SMALL: PAPER_SMALL, _OF_SUPERTILES: V3, _OF_STREAMS: V3_STREAMS}
    return next((config for units, config in of_units.items() if unit in units), PAPER)
