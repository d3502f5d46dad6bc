"""Stimuli of the colour unit by super-tiles: pairs, their compact records, and the places that follow from both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from golden.msv2_ref.colour import survivor_records
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import projected_splats
from golden.msv2_ref.tile_test import tile_test
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.records import surviving_splat
from spec.supertiles import batch_place
from tb.culling import colour_stimuli
from tb.culling.colour_stimuli import Case, compact_rows, decoded
from tb.supertiles.tile_test_stimuli import pairs_of

USED = tuple(range(1, 1 << MAX_LEVELS))
"""The sets of levels that a pair can have."""


def inputs(config: AcceleratorConfig, case: Case) -> dict[str, np.ndarray]:
    """Rows of the input streams. No item ends a frame here."""
    rows = case.inputs(config)
    return {"survivors": rows["survivors"][rows["survivors"]["end"] == 0], "data": rows["data"]}


def places(config: AcceleratorConfig, case: Case) -> np.ndarray:
    """(R,) BatchPlace records of the pairs in a case."""
    splats = np.concatenate(case.frames)
    geometry, colour = zip(*(decoded(records, case.sh_degree) for records in case.records), strict=True)
    records, _ = survivor_records(
        config, splats, np.concatenate(colour), case.sh_degree, 0, np.concatenate(geometry)["log2_opacity"])
    pair, level = np.nonzero(splats["levels"][:, None] >> np.arange(MAX_LEVELS) & 1)
    found = np.zeros(len(pair), batch_place(config).dtype)
    for name in records.dtype.names:
        found[name] = records[name]
    found["level"], found["mask"] = level, splats["mask"][pair]
    found["last"] = np.append(pair[1:] != pair[:-1], len(pair) > 0)[: len(pair)]
    return found


def random_case(
    config: AcceleratorConfig, seed: int, sh_degree: int, count: int, *, name: str | None = None,
    levels: Sequence[int] = USED,
) -> Case:
    """Random pairs and records."""
    return colour_stimuli.random_case(config, seed, sh_degree, [count], name=name, levels=levels)


def extreme_case(config: AcceleratorConfig, sh_degree: int) -> Case:
    """Ends of all ranges; every pair has a level."""
    case = colour_stimuli.extreme_case(config, sh_degree)
    (rows,) = case.frames
    rows = rows.copy()
    rows["levels"][rows["levels"] == 0] = USED[-1]
    return replace(case, frames=[rows])


def frame_case(name: str, frame: Frame) -> Case:
    """The pairs of a traced frame, super-tile by super-tile, with the records of its model."""
    config, registers, words = frame.config, frame.registers, frame.words
    splats, levels = projected_splats(config, words, registers)[:-1], registers.header[:, :2]
    test = tile_test(config, splats, levels, registers.width, registers.height)
    found = pairs_of(test, splats["index"], levels, registers.width)
    order = np.lexsort((found.splat, splats["depth_key"][found.splat], found.supertile))
    rows = found.splat[order]
    survivors = np.zeros(len(order), surviving_splat(config).dtype)
    for field in {*splats.dtype.names} & {*survivors.dtype.names} - {"end"}:
        survivors[field] = splats[field][rows]
    survivors["levels"], survivors["mask"] = found.levels[order], found.mask[order]
    return Case(name, [survivors], [compact_rows(words.compact, splats["index"][rows])], words.sh_degree)
