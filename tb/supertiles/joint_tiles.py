"""Stimuli of the tile test in joint frames (`spec.joint`): frames of splats for both eyes, and their pairs, which both eyes
share.

What is expected follows from the intersections of each eye's whole frame, which `golden.msv2_ref.tile_test` finds without
knowing of super-tiles or of the other eye.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, SUPER_Y, TILE
from spec.joint import EYES, grid_origins, joint_columns
from spec.records import projected_splat, surviving_splat, tile_level
from spec.supertiles import supertile_pair
from tb.culling.tile_test_stimuli import Case, random_case
from tb.supertiles.tile_test_stimuli import PairsFound, numbered, pairs_of, quarter_masks


class Union(NamedTuple):
    """The pairs of both eyes, in the order in which the first phase emits them: (P,) index of the Gaussian, super-tile, and
    depth key."""

    index: np.ndarray
    supertile: np.ndarray
    key: np.ndarray


@dataclass(frozen=True)
class JointSuperCase:
    """Consecutive joint frames of one size, each in both phases.

    Attributes:
        eyes: the splats and levels of source and target; their indices name the same Gaussians, with the same depth keys, and
            either eye may lack some.
        shift: the distance of the grids.
    """

    eyes: tuple[Case, Case]
    shift: int

    @property
    def name(self) -> str:
        """The case's name, for messages."""
        return self.eyes[0].name

    @property
    def config(self) -> AcceleratorConfig:
        """The machine's configuration."""
        return self.eyes[0].config

    @property
    def columns(self) -> int:
        """Columns of joint super-tiles."""
        return joint_columns(-(-self.eyes[0].width // TILE), self.shift)

    @cached_property
    def found(self) -> list[list[PairsFound]]:
        """The pairs of each eye, by frame."""
        origins = grid_origins(self.shift)
        return [[pairs_of(eye.golden[k], splats["index"], levels, eye.width, origin=origin, columns=self.columns)
                 for eye, origin in zip(self.eyes, origins, strict=True) for splats, levels in [eye.frames[k]]]
                for k in range(len(self.eyes[0].frames))]

    @cached_property
    def union(self) -> list[Union]:
        """The pairs of each frame."""
        unions = []
        for k, found in enumerate(self.found):
            rows = []
            for eye, (case, pairs) in enumerate(zip(self.eyes, found, strict=True)):
                splats = case.frames[k][0]
                rows += [(index, eye, supertile, key) for index, supertile, key in zip(
                    splats["index"][pairs.splat].tolist(), pairs.supertile.tolist(), splats["depth_key"][pairs.splat].tolist(),
                    strict=True)]
            source = {(index, supertile) for index, eye, supertile, _ in rows if not eye}
            kept = sorted(row for row in rows if not row[1] or (row[0], row[2]) not in source)
            unions.append(Union(*(np.array([row[n] for row in kept], np.int64) for n in (0, 2, 3))))
        return unions

    def _moved(self, k: int, eye: int) -> np.ndarray:
        """The splats of an eye in frame `k`, with boxes in the columns of joint super-tiles."""
        splats = self.eyes[eye].frames[k][0].copy()
        splats["eye"] = eye
        for name in ("first_x", "last_x"):
            splats[name] += grid_origins(self.shift)[eye]
        return splats

    def _returning(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """The splats of frame `k` in the second phase, two for each pair, and the survivors that they become."""
        union = self.union[k]
        order = np.lexsort((union.index, union.key, union.supertile))
        index, supertile = union.index[order], union.supertile[order]
        row, column = np.divmod(supertile, self.columns)
        comes = np.zeros((len(order), EYES), projected_splat(self.config).dtype)
        leaves = np.zeros((len(order), EYES), surviving_splat(self.config).dtype)
        for eye, case in enumerate(self.eyes):
            moved, found = self._moved(k, eye), self.found[k][eye]
            other = self._moved(k, 1 - eye)
            at = np.minimum(np.searchsorted(moved["index"], index), max(len(moved) - 1, 0))
            here = moved["index"][at] == index if len(moved) else np.zeros(len(index), bool)
            comes[here, eye] = moved[at[here]]
            comes[~here, eye] = other[np.searchsorted(other["index"], index[~here])]  # what is culled can hold anything
            none = ~here
            for axis, begin, size in (("x", column * SUPER_X, SUPER_X), ("y", row * SUPER_Y, SUPER_Y)):
                first, last = (comes[f"{end}_{axis}"][:, eye] for end in ("first", "last"))
                none |= (first > begin + size - 1) | (last < begin)
            for axis, begin, size in (("x", column * SUPER_X, SUPER_X), ("y", row * SUPER_Y, SUPER_Y)):
                first, last = (comes[f"{end}_{axis}"][:, eye] for end in ("first", "last"))
                comes[f"first_{axis}"][:, eye] = np.where(none, begin, np.maximum(first, begin))
                comes[f"last_{axis}"][:, eye] = np.where(none, begin + size - 1, np.minimum(last, begin + size - 1))
            comes["none"][:, eye], comes["eye"][:, eye] = none, eye
            for name in {*comes.dtype.names} & {*leaves.dtype.names} - {"end"}:
                leaves[name][:, eye] = comes[name][:, eye]
            masks = found.mask if self.config.streams == 1 else quarter_masks(case, k, found)
            pair = {key: n for n, key in enumerate(zip(moved["index"][found.splat].tolist(), found.supertile.tolist(),
                                                       strict=True))}
            for n, key in enumerate(zip(index.tolist(), supertile.tolist(), strict=True)):
                if key in pair:
                    leaves["levels"][n, eye], leaves["mask"][n, eye] = found.levels[pair[key]], masks[pair[key]]
        return comes.reshape(-1), leaves.reshape(-1)

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """Items of the bench's input streams."""
        end, parts, tables = np.zeros(1, projected_splat(self.config).dtype), [], []
        end["end"] = 1
        for k in range(len(self.eyes[0].frames)):
            both = np.concatenate([self._moved(k, eye) for eye in range(EYES)])
            parts += [both[np.lexsort((both["eye"], both["index"]))], end, self._returning(k)[0], end]
            for eye, case in enumerate(self.eyes):
                levels = case.frames[k][1]
                table = np.zeros(len(levels), tile_level(self.config).dtype)
                table["tile"], table["level"], table["blend"] = np.arange(len(levels)), levels[:, 0], levels[:, 1]
                table["eye"] = eye
                tables.append(table)
        return {"splats": np.concatenate(parts), "table": np.concatenate(tables)}

    @property
    def expected(self) -> dict[str, np.ndarray]:
        """Items of the output streams; the eye of a pair means nothing behind the unit but is known: the first that has it."""
        pairs, survivors = [], []
        for k, union in enumerate(self.union):
            items = np.zeros(len(union.index) + 1, supertile_pair(self.config).dtype)
            items["index"][:-1], items["supertile"][:-1], items["depth_key"][:-1] = union
            source = self.eyes[0].frames[k][0]["index"][self.found[k][0].splat]
            own = set(zip(source.tolist(), self.found[k][0].supertile.tolist(), strict=True))
            items["eye"][:-1] = [(i, s) not in own for i, s in zip(union.index.tolist(), union.supertile.tolist(), strict=True)]
            items["end"][-1] = 1
            pairs.append(items)
            survivors.append(self._returning(k)[1])
        return {"pairs": np.concatenate(pairs), "survivors": np.concatenate(survivors)}

    @property
    def observed(self) -> dict[str, int]:
        """Plain outputs after the last frame."""
        touched, filtered = (sum(getattr(eye.golden[-1], name) for eye in self.eyes) for name in ("touched", "filtered"))
        return {"touched": touched, "filtered": filtered, "entries": touched - filtered,
                "survivors_count": len(np.unique(self.union[-1].index)), "filled": 1, "busy": 0}

    @property
    def settings(self) -> dict[str, int]:
        """Values of the unit's plain inputs."""
        return self.eyes[0].settings | {"joint": 1, "shift": self.shift & 31}


def joint_random_case(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, width: int, height: int, count: int, shift: int, *,
    frames: int = 1, share: float = 0.2, **options: object,
) -> JointSuperCase:
    """Frames of splats that are apart by the shift and some pixels; each eye lacks a `share` of them."""
    source = numbered(random_case(config, rng, name, width, height, count, frames=frames, **options))
    other = numbered(random_case(config, rng, name, width, height, count, frames=frames, **options))
    eyes: list[list[tuple[np.ndarray, np.ndarray]]] = [[], []]
    for (splats, levels), (others, other_levels) in zip(source.frames, other.frames, strict=True):
        others = others.copy()
        others["depth_key"] = splats["depth_key"]
        near = rng.random(len(splats)) < 0.7  # most are at about the same place in both eyes
        shown = others.copy()
        shown[near] = splats[near]
        eyes[0].append((splats[rng.random(len(splats)) >= share], levels))
        eyes[1].append((shown[rng.random(len(splats)) >= share], other_levels))
    return JointSuperCase(tuple(
        Case(name, config, width, height, tuple(mine), source.obb) for mine in eyes), shift)
