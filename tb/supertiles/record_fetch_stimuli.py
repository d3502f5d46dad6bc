"""Stimuli of record fetch: models in memory, sorted pairs, and the points that the golden decoder makes of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from golden.host import compact
from golden.host.quantise import GaussianWords, quantise_model
from spec.chunks import CHUNK, PLACE_BITS, chunk_header
from spec.compact import COARSE_BOUND, FINE_LEVELS, OPACITY_BITS, compact_colour
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import BEAT_BYTES
from spec.packing import pack, unpack
from spec.records import chunk_item, gaussian_point
from spec.supertiles import CHUNK_BITS
from tb.chunks import decode_stimuli
from tb.chunks.chunk_test_stimuli import cloud


@dataclass(frozen=True)
class Model:
    """A model as memory holds it.

    Attributes:
        chunks: (C,) headers.
        records: (N, BEAT_BYTES) uint8, the CompactColour of every Gaussian, by `first` + place less `first` of chunk 0.
        numbers: (C,) int64, the numbers of the chunks; chunks between them are not in use.
    """

    chunks: np.ndarray
    records: np.ndarray
    numbers: np.ndarray

    @property
    def index(self) -> np.ndarray:
        """(N,) int64: the indices of all Gaussians, chunk << PLACE_BITS | place."""
        counts = self.chunks["count"].astype(np.int64)
        begin = np.cumsum(counts) - counts
        return np.repeat((self.numbers << PLACE_BITS) - begin, counts) + np.arange(counts.sum())

    def split(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(row of `chunks`, row of `records`), int64, of Gaussians by their index."""
        chunk = np.searchsorted(self.numbers, index >> PLACE_BITS)
        first = self.chunks["first"].astype(np.int64)
        return chunk, first[chunk] - first[0] + (index & CHUNK - 1)


def random_model(
    config: AcceleratorConfig, rng: np.random.Generator, counts: Sequence[int], numbers: Sequence[int] | None = None, *,
    first: int = 0,
) -> Model:
    """A model whose chunks have these numbers of Gaussians. All codes of geometry are equally likely; opacities of levels are
    equal, close to each other, or any.

    Args:
        config: the machine.
        rng: draws the model.
        counts: Gaussians of each chunk.
        numbers: the chunks' numbers, ascending; None for 0, 1, ...
        first: position of the first Gaussian in memory.
    """
    counts = np.asarray(counts, np.int64)
    chunks = decode_stimuli.headers(config, rng, len(counts), rng.random(len(counts)) < 0.4)
    chunks["count"], chunks["first"] = counts, first + np.cumsum(counts) - counts
    of = np.repeat(chunks, counts)
    coarse = of["bound"] == COARSE_BOUND
    rows = np.zeros(len(of), compact_colour(config, coarse=True).dtype)
    shapes = decode_stimuli.records(config, rng, of)
    for name in ("position", "scale", "largest", "quaternion"):
        rows[name] = shapes[name]
    base = rng.integers(0, 1 << OPACITY_BITS, (len(of), 1))
    spread = rng.choice([0, 1, 2, 1 << OPACITY_BITS], (len(of), 1))
    rows["opacity"] = np.clip(base + rng.integers(-spread, spread + 1, (len(of), MAX_LEVELS)), 0, (1 << OPACITY_BITS) - 1)
    rows["opacity"][~coarse, FINE_LEVELS:] = 0
    rows["dc_range"] = rng.integers(0, 4, len(of))
    words = compact.CompactWords(config, coarse, shapes, rows, None)
    records = words.colour_bytes()
    for kind in (False, True):  # base colours, and bits that no field has, are no business of the unit
        used = compact_colour(config, kind).width - 3 * compact_colour(config, kind).fields[-1].format.width
        noise = rng.integers(0, 256, (len(of), BEAT_BYTES), np.uint8)
        above = np.frombuffer(((1 << 8 * BEAT_BYTES) - (1 << used)).to_bytes(BEAT_BYTES, "little"), np.uint8)
        records = np.where((coarse == kind)[:, None], records & ~above | noise & above, records)
    return Model(chunks, records, np.arange(len(counts)) if numbers is None else np.asarray(numbers, np.int64))


def cloud_model(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> tuple[Model, np.ndarray]:
    """(model, (N,) points) of a cloud of Gaussians that the host has cut into chunks and encoded. The points are those that the
    first phase reads, from the records of geometry."""
    return stored_model(config, quantise_model(config, cloud(rng, count)))


def stored_model(config: AcceleratorConfig, words: GaussianWords) -> tuple[Model, np.ndarray]:
    """(model, (N,) points of the first phase) of a model that the host has encoded."""
    model = Model(words.chunks, replace(words.compact, harmonics=None).colour_bytes(), np.arange(len(words.chunks)))
    return model, decode_stimuli.points(config, words.chunks, words.compact.geometry, model.index)


def points_of(config: AcceleratorConfig, of: np.ndarray, records: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(N,) GaussianPoint items of pairs with these headers and CompactColours (N, BEAT_BYTES), by the golden decoder."""
    out, bound = np.zeros(len(of), gaussian_point(config).dtype), of["bound"].astype(np.int64)
    for kind in (False, True):
        rows = np.flatnonzero((bound == COARSE_BOUND) == kind)
        record, header = compact_colour(config, kind), of[rows].copy()
        held, header["count"] = unpack(record, records[rows, : (record.width + 7) // 8]), 1
        for name, raw in compact.decode_shape(config, header, held).items():
            out[name][rows] = raw
        code = held["opacity"].astype(np.int64)
        strongest = np.where(np.arange(code.shape[1]) <= bound[rows, None], code, 0).max(axis=1, initial=0)
        out["log2_opacity"][rows] = compact.decoded_opacity(strongest)
    out["bound"], out["index"] = bound, index
    return out


def header_bytes(config: AcceleratorConfig, chunks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, BEAT_BYTES) uint8: headers in memory; bits that no field has are random."""
    record = chunk_header(config)
    out = pack(record, chunks, BEAT_BYTES)
    above = np.frombuffer(((1 << 8 * BEAT_BYTES) - (1 << record.width)).to_bytes(BEAT_BYTES, "little"), np.uint8)
    return out | rng.integers(0, 256, out.shape, np.uint8) & above


@dataclass(frozen=True)
class Case:
    """Sorted pairs of a model.

    Attributes:
        name: the case's name, for messages.
        model: the model.
        index: (P,) int64, the pairs' indices.
        empty: number of items without a pair among them.
    """

    name: str
    model: Model
    index: np.ndarray
    empty: int = 0

    def sorted(self, config: AcceleratorConfig, rng: np.random.Generator) -> np.ndarray:
        """The ChunkItem items."""
        items = np.zeros(len(self.index), chunk_item(config).dtype)
        items["index"] = self.index
        for f in chunk_item(config).fields:
            if f.name in ("depth_key", "tile", "last"):
                items[f.name] = rng.integers(0, f.raw_range[1] + 1, len(items))
        none = np.zeros(1, items.dtype)
        none["last"] = none["empty"] = 1
        none["index"] = rng.integers(0, 1 << CHUNK_BITS + PLACE_BITS)
        return np.insert(items, rng.integers(0, len(items) + 1, self.empty), none)


def _some(rng: np.random.Generator, chunks: int) -> np.ndarray:
    return rng.integers(1, CHUNK + 1, chunks)


def _in_order(config: AcceleratorConfig, rng: np.random.Generator) -> Case:
    """All Gaussians of chunks of every length, in the order of memory and then backwards, from an odd position on."""
    model = random_model(config, rng, [*range(1, CHUNK + 1), *_some(rng, 3)], first=12345)
    return Case("all in order", model, np.concatenate([model.index, model.index[::-1]]), 5)


def _again(config: AcceleratorConfig, rng: np.random.Generator) -> Case:
    """Chunks in consecutive pairs, so that hits meet a pending miss, and again at every small distance."""
    model = random_model(config, rng, _some(rng, 40))
    runs = [np.repeat(model.numbers[7 + k], length) for k, length in enumerate((1, 2, 3, 5, 40))]
    apart = [np.resize(model.numbers[20 : 20 + d], 2 * d) for d in range(1, 20)]
    return Case("the same chunk again", model, _anywhere(model, rng, np.concatenate([*runs, *apart])))


def _conflicts(config: AcceleratorConfig, rng: np.random.Generator) -> Case:
    """Headers that displace each other: 2 to 8 of the same set in turn, with hits between them and without, and at random; the
    first and the last chunk of the largest model, too."""
    lines = config.header_lines
    numbers = np.unique([*(n + k * lines for n in range(2, 9) for k in range(8)), 0, lines, (1 << CHUNK_BITS) - 1,
                         (1 << CHUNK_BITS) - lines])
    model = random_model(config, rng, _some(rng, len(numbers)), numbers)
    turns = [np.tile([n + k * lines for k in range(n)], 6) for n in range(2, 9)]
    twice = [np.tile(np.repeat([n + k * lines for k in range(n)], 2), 3) for n in range(2, 9)]
    mixed = [8 + lines * rng.integers(0, 8, 200), numbers[[-1, 0, -1, -2, 0, 1, -1, -2]]]
    return Case("conflicts", model, _anywhere(model, rng, np.concatenate([*turns, *twice, *mixed])))


def _every_line(config: AcceleratorConfig, rng: np.random.Generator) -> Case:
    """Every line is filled, then hit in another order; then other headers fill the lines; finally the first ones return."""
    lines = config.header_lines
    model = random_model(config, rng, rng.integers(1, 4, 2 * lines))
    first, other = np.arange(lines), lines + rng.permutation(lines)
    order = np.concatenate([first, rng.permutation(lines), other, np.sort(other)[::-1], first])
    return Case("every line", model, _anywhere(model, rng, order), 3)


def _anywhere(model: Model, rng: np.random.Generator, numbers: np.ndarray) -> np.ndarray:
    """Indices of Gaussians anywhere in the chunks of these numbers."""
    count = model.chunks["count"][np.searchsorted(model.numbers, numbers)]
    return numbers << PLACE_BITS | rng.integers(0, count)


DIRECTED: tuple[Callable[[AcceleratorConfig, np.random.Generator], Case], ...] = (_in_order, _again, _conflicts, _every_line)
"""Functions that make the hand-made cases."""


def random_case(config: AcceleratorConfig, name: str, seed: int, pairs: int = 700) -> Case:
    """Pairs near each other in memory, as those of neighbouring splats, that wander over 4 times the cache's headers."""
    rng = np.random.default_rng(seed)
    model = random_model(config, rng, _some(rng, 4 * config.header_lines), first=int(rng.integers(1 << 20)))
    near = np.cumsum(rng.integers(0, 3, pairs)) * len(model.numbers) // pairs + rng.integers(0, 6, pairs)
    return Case(name, model, _anywhere(model, rng, model.numbers[near % len(model.numbers)]), int(rng.integers(0, 4)))


def walking_case(config: AcceleratorConfig, name: str, seed: int, pairs: int, every: int) -> Case:
    """Pairs of which one in `every` is the first of a chunk that was not there before."""
    rng = np.random.default_rng(seed)
    model = random_model(config, rng, rng.integers(1, 5, -(-pairs // every)))
    return Case(name, model, _anywhere(model, rng, np.arange(pairs) // every))


def pooled_case(config: AcceleratorConfig, name: str, seed: int, pairs: int) -> Case:
    """Pairs of as many chunks as the cache has lines, the first of which name each chunk once."""
    rng = np.random.default_rng(seed)
    model = random_model(config, rng, _some(rng, config.header_lines))
    return Case(name, model, _anywhere(model, rng, np.resize(model.numbers, pairs)))
