"""Streamed SOG (PlayCanvas): a folder whose `lod-meta.json` names several levels of detail of one model, each in SOG folders.

The file holds `lodLevels` (their number), `filenames` (the SOGs), `environment` (null or one more SOG) and `tree`, whose leaves
have `lods`: for each level, of which 0 is the finest, a range of rows of one file. The levels are alternatives: a model is the
ranges of one level, leaf by leaf, and the environment, which belongs to every level.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.clean import Fields
from golden.scenes.files import read_json
from golden.scenes.model import GaussianModel
from golden.scenes.packed import read_sog, sog_model
from spec.errors import InputError

INDEX = "lod-meta.json"
"""The file that makes a folder a streamed SOG."""

_ARRAYS = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest")
"""The fields that a SOG has."""


@dataclass(frozen=True)
class Detail:
    """Which of the levels of detail of a streamed SOG a model is.

    Attributes:
        level: the level, 0 for the finest.
        levels: the number of levels.
        splats: the splats of the leaves' ranges.
        leaves: the number of leaves of the tree.
        replaced: the leaves that lack the level and are drawn at the nearest level that they have.
        environment: the splats of the environment.
    """

    level: int
    levels: int
    splats: int
    leaves: int
    replaced: int
    environment: int

    @property
    def note(self) -> str:
        """One line that tells a user what was loaded and how to get another level."""
        others = f" (--lod 0..{self.levels - 1} chooses; 0 is the finest)" if self.levels > 1 else ""
        parts = [f"level of detail {self.level} of {self.levels}{others}: {self.splats:,} splats"]
        if self.replaced:
            parts.append(f"{self.replaced:,} of {self.leaves:,} leaves lack it and take the nearest level instead")
        if self.environment:
            parts.append(f"and {self.environment:,} splats of the environment")
        return ", ".join(parts)


@dataclass(frozen=True)
class _Range:
    """Rows `offset` to `offset + count` of a file; `where` names the leaf in messages."""

    file: int
    offset: int
    count: int
    where: str


def add_detail_argument(parser: argparse.ArgumentParser) -> None:
    """Adds `--lod`, which `golden.scenes.request.resolve` reads."""
    parser.add_argument("--lod", type=int, default=None, metavar="N",
                        help=f"level of detail of a streamed SOG ({INDEX}); 0 is the finest (default: 0)")


def streamed_index(path: Path) -> Path | None:
    """The `lod-meta.json` that a path names or whose folder it is; None where it is no streamed SOG."""
    index = path if path.name == INDEX else path / INDEX
    return index if index.is_file() else None


def load_streamed(index: Path, level: int | None = None) -> tuple[GaussianModel, Detail]:
    """Loads one level of detail.

    A leaf that lacks the level is drawn at the nearest level that it has; where a coarser and a finer level are equally near,
    at the finer. A file with fewer spherical harmonics than another gets zeros for the missing ones, which change no colour.

    Args:
        index: the `lod-meta.json`.
        level: the level; None for the finest.

    Returns:
        The model, whose splats are in the order of the tree's leaves, and which level it is.

    Raises:
        InputError: the index is malformed, names a missing file or rows that a file does not have, or has no such level; or
            the extra `models` is not installed.
    """
    meta = read_json(index)
    levels, names = _whole(meta, "lodLevels", index, 1), meta.get("filenames")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{index}: filenames is {names!r:.60}; a list of paths is needed")
    chosen = 0 if level is None else level
    if not 0 <= chosen < levels:
        raise InputError(f"{index}: level of detail {chosen} is not accepted: 0..{levels - 1} are")
    ranges, leaves, replaced = [], 0, 0
    for where, lods in _leaves(meta.get("tree"), index):
        found = {_level(key, levels, f"{index}: {where}"): value for key, value in lods.items()}
        leaves += 1
        if found:
            nearest = min(found, key=lambda other: (abs(other - chosen), other))
            ranges.append(_range(found[nearest], len(names), f"{where}, level {nearest}", index))
            replaced += nearest != chosen
    files = {number: read_sog(_part(index, names[number])) for number in sorted({r.file for r in ranges})}
    parts = [_rows(files[r.file], r, names[r.file], index) for r in ranges]
    splats, outside = sum(len(part.means) for part in parts), meta.get("environment")
    if outside is not None:
        if not isinstance(outside, str):
            raise InputError(f"{index}: environment is {outside!r:.60}; null or a path is accepted")
        parts.append(read_sog(_part(index, outside)))
    if not parts:
        raise InputError(f"{index}: no leaf of the tree has a range of splats; at least one is needed")
    model = sog_model(_joined(parts), index, index.absolute().parent.name)
    environment = len(parts[-1].means) if outside is not None else 0
    return model, Detail(chosen, levels, splats, leaves, replaced, environment)


def _leaves(tree: object, index: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Name and `lods` of every leaf, in the order of the file."""
    todo: list[tuple[str, object]] = [("tree", tree)]
    while todo:
        where, node = todo.pop()
        if not isinstance(node, dict):
            raise InputError(f"{index}: {where} is {node!r:.60}; an object with children or lods is needed")
        children, lods = node.get("children"), node.get("lods")
        if isinstance(children, list) and lods is None:
            todo += [(f"{where}.children[{i}]", child) for i, child in reversed(list(enumerate(children)))]
        elif isinstance(lods, dict) and not children:
            yield where, lods
        else:
            raise InputError(f"{index}: {where} has the keys {sorted(node)}; children or lods are needed")


def _level(key: str, levels: int, where: str) -> int:
    if not (key.isascii() and key.isdigit() and int(key) < levels):
        raise InputError(f"{where} has a level {key!r}; \"0\"..\"{levels - 1}\" are accepted")
    return int(key)


def _range(lod: object, files: int, where: str, index: Path) -> _Range:
    if not isinstance(lod, dict):
        raise InputError(f"{index}: {where} is {lod!r:.60}; an object with file, offset and count is needed")
    file, offset, count = (_whole(lod, key, index, 0, f"{where}: ") for key in ("file", "offset", "count"))
    if file >= files:
        raise InputError(f"{index}: {where}: file {file} is not accepted: 0..{files - 1} are")
    return _Range(file, offset, count, where)


def _whole(values: Mapping[str, Any], key: str, index: Path, least: int, where: str = "") -> int:
    value = values.get(key)
    if type(value) is not int or value < least:
        raise InputError(f"{index}: {where}{key} is {value!r:.60}; a whole number of at least {least} is needed")
    return value


def _part(index: Path, name: str) -> Path:
    path = index.parent / name
    try:
        there = path.exists()
    except (OSError, ValueError):  # no file can have this name: it is too long, or has a NUL
        there = False
    if not there:
        raise InputError(f"{index}: names {name!r:.200}, which does not exist; all files of a level are needed")
    return path


def _rows(fields: Fields, rows: _Range, name: str, index: Path) -> Fields:
    total, end = len(fields.means), rows.offset + rows.count
    if end > total:
        raise InputError(f"{index}: {rows.where}: rows {rows.offset}..{end - 1} are not accepted: {name} has {total}")
    return Fields(**{array: getattr(fields, array)[rows.offset : end] for array in _ARRAYS})


def _joined(parts: list[Fields]) -> Fields:
    """The parts behind each other; harmonics that only some of the parts have are zero in the others."""
    most = max(part.sh_rest.shape[1] for part in parts)
    arrays = {array: np.concatenate([getattr(part, array) for part in parts]) for array in _ARRAYS if array != "sh_rest"}
    rest = [np.pad(part.sh_rest, ((0, 0), (0, most - part.sh_rest.shape[1]), (0, 0))) for part in parts]
    return Fields(**arrays, sh_rest=np.concatenate(rest))
