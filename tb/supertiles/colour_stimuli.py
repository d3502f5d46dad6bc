"""Stimuli of the colour unit by super-tiles: pairs, their compact records, and the places that follow from both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from golden.msv2_ref.colour import survivor_records
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import projected_splats
from golden.msv2_ref.tile_test import tile_test
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.joint import EYES
from spec.records import surviving_splat
from spec.supertiles import batch_place
from tb.culling import colour_stimuli
from tb.culling.colour_stimuli import Case, compact_rows, decoded, random_survivors
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
    return _places(config, case, splats, splats["offset"], np.arange(len(splats)))


def _places(config: AcceleratorConfig, case: Case, splats: np.ndarray, offset: np.ndarray, pair: np.ndarray) -> np.ndarray:
    """Places of splats.

    Args:
        config: the machine.
        case: has the records of the pairs.
        splats: (N,) SurvivingSplat records, pair by pair.
        offset: (N, 3) the directions of their colours.
        pair: (N,) the pair of each.
    """
    lit = splats.copy()
    lit["offset"] = offset
    geometry, colour = zip(*(decoded(records, case.sh_degree) for records in case.records), strict=True)
    records, _ = survivor_records(
        config, lit, np.concatenate(colour)[pair], case.sh_degree, 0, np.concatenate(geometry)["log2_opacity"][pair])
    splat, level = np.nonzero(splats["levels"][:, None] >> np.arange(MAX_LEVELS) & 1)
    found, pair = np.zeros(len(splat), batch_place(config).dtype), pair[splat]
    for name in records.dtype.names:
        found[name] = records[name]
    found["level"], found["mask"] = level, splats["mask"][splat]
    found["last"] = np.append(pair[1:] != pair[:-1], len(pair) > 0)[: len(pair)]
    if config.joint:
        found["eye"] = splats["eye"][splat]
    return found


class JointCase(NamedTuple):
    """The pairs of a joint frame.

    Attributes:
        case: the pairs with their records, and what each is in the source.
        target: (N,) SurvivingSplat records, what each is in the target.
        shared: whether both eyes have the source's colours.
    """

    case: Case
    target: np.ndarray
    shared: bool

    @property
    def survivors(self) -> np.ndarray:
        """(2 N,) the items of both eyes."""
        return np.stack([*self.case.frames, self.target], 1).reshape(-1)

    def inputs(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """Rows of the input streams."""
        return {"survivors": self.survivors, "data": inputs(config, self.case)["data"]}

    def places(self, config: AcceleratorConfig) -> np.ndarray:
        """(R,) BatchPlace records of the pairs."""
        splats, pair = self.survivors, np.repeat(np.arange(len(self.target)), EYES)
        offset = splats["offset"][EYES * pair] if self.shared else splats["offset"]
        return _places(config, self.case, splats, offset, pair)


def joint_case(
    config: AcceleratorConfig, seed: int, sh_degree: int, count: int, *, shared: bool, name: str | None = None,
    levels: Sequence[int] = USED, alone: float = 0.3,
) -> JointCase:
    """Random pairs and records; a share `alone` of the pairs each has no level in the source, and none in the target."""
    name = name or f"joint, {'one colour' if shared else 'two colours'}, degree {sh_degree}"
    case, rng = random_case(config, seed, sh_degree, count, name=name, levels=levels), np.random.default_rng((seed, 1))
    (source,) = case.frames
    target, drawn = random_survivors(config, rng, count, levels), rng.random(count)
    target["bound"], target["eye"], target["index"] = source["bound"], 1, source["index"]
    for rows, empty in ((source, drawn < alone), (target, drawn > 1 - alone)):
        rows["levels"][empty], rows["mask"][empty] = 0, 0
    return JointCase(case, target, shared)


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


def joint_frame_case(name: str, frame: JointFrame) -> JointCase:
    """The pairs of a traced joint frame, with the records of its model."""
    config, words, pairs = frame.config, frame.source.words, frame.pairs
    masks = JointBatches(frame).stream_masks
    eyes = []
    for eye, drawn in enumerate(frame.eyes):
        splats = projected_splats(config, words, drawn.registers, drawn.projected)[:-1]
        row = np.full(len(words.geometry), -1)
        row[splats["index"]] = np.arange(len(splats))
        there, survivors = pairs.mask[:, eye] != 0, np.zeros(len(pairs.splat), surviving_splat(config).dtype)
        for field in {*splats.dtype.names} & {*survivors.dtype.names} - {"end", "eye"}:
            survivors[field][there] = splats[field][row[pairs.splat[there]]]
        survivors["levels"], survivors["mask"] = pairs.levels[:, eye], masks[:, eye, 0]
        survivors["bound"], survivors["eye"] = words.geometry["bound"][pairs.splat], eye
        survivors["offset"] = config.formats.view.quantise(words.decoded.mean[pairs.splat] - drawn.registers.position)
        eyes.append(survivors)
    case = Case(name, [eyes[0]], [compact_rows(words.compact, pairs.splat)], words.sh_degree)
    return JointCase(case, eyes[1], frame.registers.shared_colour)
