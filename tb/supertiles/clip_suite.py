"""The tests of the clip: boxes are compared with a plain statement of what lies in a super-tile."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from rtl.emit import to_verilog
from rtl.supertiles.clip import SuperTileClip
from spec.config import TINY_EYES, TINY_V3, V3, AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.joint import EYES
from spec.records import TILE_BITS, projected_splat
from spec.supertiles import supertile
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.culling.colour_stimuli import random_rows

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3, "tiny_eyes": TINY_EYES}
"""Configurations that can be tested."""

DISTINCT = ("tiny_v3", "tiny_eyes")
"""Configurations with different units."""

PORTS = ("splats", "supertiles", "clipped")

MOST_TILES = 1 << TILE_BITS
"""Tiles of a row or a column that the fields of a box can number."""

_SETTLING = 5


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit, emitted as Verilog, with a file at each stream."""
    splats = projected_splat(config)
    return Playback(
        name=f"supertile-clip{'-joint' * config.joint}", module="supertile_clip",
        verilog=emitted("supertile-clip", config, lambda config: to_verilog(SuperTileClip(config), "supertile_clip")),
        inputs=(Stream("splats", splats), Stream("supertiles", supertile(config))), outputs=(Stream("clipped", splats),),
        settings=(("rendering", 1), *((("joint", 1),) if config.joint else ())), observed=(("busy", 1),))


def _part(box: range, begin: int, size: int) -> tuple[int, int]:
    """First and last of the columns or rows of a box that lie among `size` from `begin` on."""
    inside = [place for place in range(begin, begin + size) if place in box]
    return inside[0], inside[-1]


def second_phase(config: AcceleratorConfig, rng: np.random.Generator, name: str, counts: Sequence[int], **options: object,
                 ) -> Planned:
    """Super-tiles anywhere in the largest frame that the fields hold, with so many pairs. Boxes begin and end inside and
    outside."""
    tiles = MOST_TILES
    supers = random_rows(rng, supertile(config), len(counts))
    supers["pairs"] = counts
    for axis, size in (("x", SUPER_X), ("y", SUPER_Y)):
        supers[axis] = rng.integers(0, tiles // size, len(counts)) * size
    owner = np.repeat(np.arange(len(counts)), counts)
    splats = random_rows(rng, projected_splat(config), len(owner))
    splats["end"] = 0
    if config.joint:
        supers["eye"], splats["none"] = 0, 0
    for axis, size in (("x", SUPER_X), ("y", SUPER_Y)):
        inside = supers[axis][owner] + rng.integers(0, size, len(owner))  # a tile that is in both
        reach = rng.choice([0, 1, 2, 5, SUPER_TILES, tiles // 2, tiles], (2, len(owner)))
        splats[f"first_{axis}"] = np.maximum(inside - reach[0], 0)
        splats[f"last_{axis}"] = np.minimum(inside + reach[1], tiles - 1)
    expected = splats.copy()
    for axis, size in (("x", SUPER_X), ("y", SUPER_Y)):
        first, last = f"first_{axis}", f"last_{axis}"
        boxes, box = np.unique(np.stack([splats[first], splats[last], supers[axis][owner]]), axis=1, return_inverse=True)
        parts = [_part(range(begin, end + 1), base, size) for begin, end, base in boxes.T.tolist()]
        expected[first], expected[last] = np.array(parts).reshape(-1, 2)[box].T
    return planned(
        name, {"splats": splats, "supertiles": supers}, {"clipped": expected}, observed={"busy": 0},
        settings={"rendering": 1, **({"joint": 0} if config.joint else {})}, **options)


def joint_phase(config: AcceleratorConfig, rng: np.random.Generator, name: str, counts: Sequence[int], **options: object,
                ) -> Planned:
    """The second phase of a joint frame: two super-tiles and two splats for each pair. Boxes lie in a super-tile, across its
    edges or beside it, and some splats are culled."""
    tiles = -(-config.row_width // TILE)
    supers = np.repeat(random_rows(rng, supertile(config), len(counts)), EYES)
    supers["pairs"], supers["eye"] = np.repeat(counts, EYES), np.tile(np.arange(EYES), len(counts))
    for axis, size in (("x", SUPER_X), ("y", SUPER_Y)):
        supers[axis] = np.repeat(rng.integers(0, -(-tiles // size), len(counts)) * size, EYES)
    base = supers[np.repeat(EYES * np.arange(len(counts)), EYES * np.asarray(counts))]
    splats = random_rows(rng, projected_splat(config), len(base))
    splats["end"], splats["eye"], splats["none"] = 0, np.arange(len(base)) % EYES, rng.random(len(base)) < 0.2
    for axis, size in (("x", SUPER_X), ("y", SUPER_Y)):
        middle = base[axis].astype(np.int64) + rng.integers(-2, size + 2, len(base))
        reach = rng.choice([0, 1, 2, SUPER_TILES, tiles], (2, len(base)))
        splats[f"first_{axis}"] = np.maximum(middle - reach[0], 0)
        splats[f"last_{axis}"] = np.maximum(middle + reach[1], 0)
    expected = splats.copy()
    for splat, at in zip(expected, base, strict=True):
        parts = {axis: [place for place in range(int(at[axis]), int(at[axis]) + size)
                        if splat[f"first_{axis}"] <= place <= splat[f"last_{axis}"]]
                 for axis, size in (("x", SUPER_X), ("y", SUPER_Y))}
        if splat["none"] or not all(parts.values()):
            splat["none"] = 1
            parts = {axis: [int(at[axis]), int(at[axis]) + size - 1] for axis, size in (("x", SUPER_X), ("y", SUPER_Y))}
        for axis, part in parts.items():
            splat[f"first_{axis}"], splat[f"last_{axis}"] = part[0], part[-1]
    return planned(name, {"splats": splats, "supertiles": supers}, {"clipped": expected}, observed={"busy": 0},
                   settings={"rendering": 1, "joint": 1}, **options)


def first_phase(config: AcceleratorConfig, rng: np.random.Generator, count: int, **options: object) -> Planned:
    """Splats pass as they are, and no super-tile is taken."""
    splats = random_rows(rng, projected_splat(config), count)
    none = np.zeros(0, supertile(config).dtype)
    return planned("first phase", {"splats": splats, "supertiles": none}, {"clipped": splats}, observed={"busy": 0},
                   settings={"rendering": 0, **({"joint": 1} if config.joint else {})}, **options)


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Both phases, empty super-tiles, every pattern on every port, resets, and full rate."""
    rng = np.random.default_rng(seed)
    many = rng.choice([0, 0, 1, 1, 2, 3, 20], 60)
    plan = [first_phase(config, rng, 100, most_cycles=100 + _SETTLING),
            second_phase(config, rng, "one super-tile", [50], most_cycles=51 + _SETTLING),
            second_phase(config, rng, "full rate, a pair each", [1] * 80, most_cycles=81 + _SETTLING)]
    full = second_phase(config, rng, "full rate, any number", many,
                        most_cycles=int(np.maximum(many, 1).sum()) + _SETTLING)
    plan.append(second_phase(config, rng, "many pairs", [9000, 1, 4097, 700]))
    plan.append(second_phase(config, rng, "a number of pairs of 18 bits", [(1 << 17) + 4, 3]))
    plan += [full, second_phase(config, rng, "after empty ones", [0] * 30 + [2] + [0] * 7 + [5, 0])]
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(second_phase(config, rng, name, rng.choice([0, 1, 2, 9], 40), patterns=patterns, reset=False))
    for cycles in (2, 7, 30):
        plan.append(second_phase(config, rng, f"cut off after {cycles} cycles", [3] * 30, abort=cycles))
        plan.append(second_phase(config, rng, f"after a reset at {cycles}", [0, 1, 4]))
    return plan + (joint_plan(config, seed) if config.joint else [])


def joint_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """The same of joint frames, in which the item of a target takes a cycle where nothing else does."""
    rng = np.random.default_rng(seed)
    many = rng.choice([0, 0, 1, 1, 2, 3, 20], 60)
    plan = [joint_phase(config, rng, "joint, one super-tile", [200], most_cycles=401 + _SETTLING),
            joint_phase(config, rng, "joint, any number", many,
                        most_cycles=int(np.maximum(EYES * many, EYES).sum()) + len(many) + _SETTLING)]
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(joint_phase(config, rng, f"joint, {name}", rng.choice([0, 1, 2, 9], 40), patterns=patterns, reset=False))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return unit_plan(config, seed)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    return [f"{item.name}: {len(item.expected['clipped'])} splats in {recording.cycles} cycles"
            for item, recording in exact.at_full_rate(plan, outcome, "full rate")]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
