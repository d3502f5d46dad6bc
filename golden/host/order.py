"""The order of a model's Gaussians in memory.

Memory opens a row of a bank for every access that does not hit an open one, so Gaussians that a frame reads together should lie
together. An order of CANDIDATES sorts

1. by the Morton code of contracted coordinates, which keep far points from squeezing the near ones into a few cells, and by the
   bits of the wide record, geometry first: so the order is total, and depends neither on the order of the model's file nor on
   which of several coincident points comes first there;
2. by what lies `apart` in the whole model;
3. by what is sorted `inside` blocks of `block` Gaussians of that order.

There are two such things: `bound`, the quality bound, the highest first, so that the Gaussians of a chunk have the same
levels; and `large`, so that the largest LARGE_SHARE of all splats do not blow up the bounds of many chunks. Where bounds are
sorted in the whole model, a frame's survivors cluster more than its colour unit likes, and a row of memory holds no neighbours
of other bounds.

The study `v3` compares the candidates by the cycles of an LPDDR3 memory; `SPATIAL` is the one of machines with
`order = "spatial"`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spec.chunks import CHUNK
from spec.config import AcceleratorConfig
from spec.packing import pack
from spec.records import gaussian_colour, gaussian_geometry

LARGE_SHARE = 0.02
"""Share of the splats, the largest ones, that lie apart from all others of their bound."""

MORTON_BITS = 21
"""Bits of a coordinate in a Morton code; three of them fit 64 bits."""



class Candidate(NamedTuple):
    """An order: what lies apart in the whole model, and what is sorted inside blocks of so many Gaussians, each with the most
    significant first."""

    apart: tuple[str, ...] = ()
    block: int = CHUNK
    inside: tuple[str, ...] = ()


CANDIDATES = {
    "file": None,
    "morton": Candidate(),
    "big+morton": Candidate(("large",)),
    "level+morton": Candidate(("bound",)),
    "level+big+morton": Candidate(("bound", "large")),
    "big+blocks": Candidate(("large",), 1024, ("bound",)),
}
"""Orders by name; None is the order of the model's file."""

SPATIAL = CANDIDATES["big+blocks"]
"""The candidate that machines with `order = "spatial"` have."""

_SPREAD = (
    (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249))


def contracted(mean: np.ndarray) -> np.ndarray:
    """(N, 3) float64 in [-2, 2]: positions (N, 3) relative to their median, in units of the median distance from it. Distances
    r above 1 become 2 - 1 / r, as in Mip-NeRF 360."""
    middle = mean - np.median(mean, axis=0)
    radius = np.sqrt(middle[:, 0] ** 2 + middle[:, 1] ** 2 + middle[:, 2] ** 2)[:, None]
    unit = np.median(radius)
    radius = radius / (unit if unit > 0 else 1.0)
    far = np.maximum(radius, 1.0)
    return middle / (unit if unit > 0 else 1.0) * ((2 - 1 / far) / far)


def morton(places: np.ndarray) -> np.ndarray:
    """(N,) uint64 Morton codes of coordinates (N, 3) in [-2, 2]; the bits of x are the lowest of each three."""
    most = (1 << MORTON_BITS) - 1
    cells = np.clip(np.floor((places + 2) / 4 * (most + 1)), 0, most).astype(np.uint64)
    for shift, mask in _SPREAD:
        cells = (cells | cells << np.uint64(shift)) & np.uint64(mask)
    return np.asarray(cells[:, 0] | cells[:, 1] << np.uint64(1) | cells[:, 2] << np.uint64(2))


def _bits(config: AcceleratorConfig, geometry: np.ndarray, colour: np.ndarray, sh_degree: int) -> np.ndarray:
    """(words, N) uint64: the bits of the wide records, the most significant word first."""
    records = (gaussian_geometry(config), geometry), (gaussian_colour(config, sh_degree), colour)
    return np.concatenate([
        pack(record, rows, -(-record.width // 64) * 8).view("<u8").T[::-1] for record, rows in records])


def memory_order(
    config: AcceleratorConfig, geometry: np.ndarray, colour: np.ndarray, sh_degree: int, order: Candidate | None = SPATIAL,
) -> np.ndarray:
    """(N,) int64: the row of the given words that comes first in memory, second, and so on.

    Args:
        config: the machine whose formats the words have.
        geometry, colour: (N,) wide records of `spec.records`.
        sh_degree: the degree of the colour records.
        order: how to sort; None leaves the rows as they are.
    """
    count, n = len(geometry), config.formats
    if order is None or not count:
        return np.arange(count)
    base = _by_place(config, geometry, colour, sh_degree)
    size = n.scale.to_float(geometry["scale"]).max(axis=1)
    keys = {"bound": -geometry["bound"].astype(np.int64), "large": size > np.quantile(size, 1 - LARGE_SHARE)}

    def sort(rows: np.ndarray, names: tuple[str, ...], first: np.ndarray) -> np.ndarray:
        return rows[np.lexsort([*(keys[name][rows] for name in reversed(names)), first])]

    base = sort(base, order.apart, np.zeros(count))
    part = np.zeros(count, np.int64)
    for name in order.apart:
        part[1:] += keys[name][base[1:]] != keys[name][base[:-1]]
    part = np.cumsum(part > 0)
    place = np.arange(count) - np.searchsorted(part, part)
    begins = np.append(True, (np.diff(part) > 0) | (place[1:] % order.block == 0))
    return sort(base, order.inside, np.cumsum(begins))


def _by_place(config: AcceleratorConfig, geometry: np.ndarray, colour: np.ndarray, sh_degree: int) -> np.ndarray:
    """Rows by Morton code, those of equal codes by the bits of their records; only these are packed."""
    place = morton(contracted(config.formats.position.to_float(geometry["mean"])))
    order = np.argsort(place, kind="stable")
    same = place[order[1:]] == place[order[:-1]]
    tied = np.flatnonzero(np.append(same, False) | np.append(False, same))
    if len(tied):
        rows = order[tied]
        bits = _bits(config, geometry[rows], colour[rows], sh_degree)
        order[tied] = rows[np.lexsort([*bits[::-1], place[rows]])]
    return order
