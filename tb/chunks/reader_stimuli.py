"""Stimuli of the reader of chunks: models in memory, the chunks that are read of them, and the beats and points that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from golden.host import compact
from spec.chunks import CHUNK, PLACE_BITS, header_item
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES, read_data, read_request
from spec.packing import pack
from spec.records import gaussian_geometry, gaussian_point
from tb.chunks import decode_stimuli


@dataclass(frozen=True)
class Case:
    """Frames of one model.

    Attributes:
        name: the name of its run.
        inputs, expected: rows of the streams.
        error: whether a beat that is read has an error.
        points: number of Gaussians that are read.
        base: the beat of the first Gaussian.
        busy: whether the last frame's end does not come.
    """

    name: str
    inputs: dict[str, np.ndarray]
    expected: dict[str, np.ndarray]
    error: bool
    points: int
    base: int
    busy: bool = False


def _wide_geometry(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> np.ndarray:
    """Any bit patterns: the reader passes them on."""
    out = np.zeros(count, gaussian_geometry(config).dtype)
    for f in gaussian_geometry(config).fields:
        low, high = f.raw_range
        out[f.name] = rng.integers(low, high + 1, out[f.name].shape)
    return out


def _model(
    config: AcceleratorConfig, rng: np.random.Generator, counts: Sequence[int], first: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(headers, points by place, bytes of the region from Gaussian 0 on) of a model whose chunks have these numbers of
    Gaussians; the Gaussians before `first` belong to no chunk."""
    counts = np.asarray(counts, np.int64)
    chunks = decode_stimuli.headers(config, rng, len(counts), rng.random(len(counts)) < 0.3)
    chunks["count"], chunks["first"] = counts, first + np.concatenate([[0], np.cumsum(counts)[:-1]])
    total = int(counts.sum())
    index = first + np.arange(total)
    if config.compact:
        of = np.repeat(chunks, counts)
        rows = decode_stimuli.records(config, rng, of)
        points = decode_stimuli.points(config, chunks, rows, index)
        stored, size = decode_stimuli.packed(config, of, rows), compact.GEOMETRY_BYTES
    else:
        geometry, size = _wide_geometry(config, rng, total), BEAT_BYTES
        geometry["bound"] = np.repeat(chunks["bound"], counts)
        points = np.zeros(total, gaussian_point(config).dtype)
        for f in gaussian_geometry(config).fields:
            points[f.name] = geometry[f.name]
        points["index"], stored = index, pack(gaussian_geometry(config), geometry, size)
    memory = rng.integers(0, 256, (first + total + 3, size), np.uint8)
    memory[first : first + total] = stored
    return chunks, points, memory[: len(memory) // 2 * 2].reshape(-1, BEAT_BYTES)


def _ending(config: AcceleratorConfig) -> np.ndarray:
    """The point with `end`: what words of 0 stand for."""
    if config.compact:
        return decode_stimuli.random_items(config, np.random.default_rng(0), 0)[1]
    out = np.zeros(1, gaussian_point(config).dtype)
    out["end"] = 1
    return out


def case(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, frames: Sequence[Sequence[int]], *, first: int = 0,
    read: float = 1.0, bad: bool = False, ends: bool = True,
) -> Case:
    """Frames whose chunks have these numbers of Gaussians.

    Args:
        config: the machine.
        rng: draws the model.
        name: the name of the run.
        frames: by frame, the numbers of Gaussians of its chunks.
        first: index of the first chunk's first Gaussian.
        read: share of the chunks that are read.
        bad: whether one beat has an error.
        ends: whether the last frame's end comes.
    """
    tested, reads, beats, points = [], [], [], []
    base = int(rng.integers(1 << BEAT_BITS - 1))
    for counts in frames:
        chunks, rows, memory = _model(config, rng, counts, first)
        numbers = np.flatnonzero(rng.random(len(chunks)) < read)
        chosen = chunks[numbers]
        items = np.zeros(len(chosen) + 1, header_item(config).dtype)
        for field in chunks.dtype.names:
            items[field][:-1] = chosen[field]
        if config.supertiles:
            items["number"][:-1] = numbers
            rows["index"] = np.repeat((np.arange(len(chunks)) << PLACE_BITS) - chunks["first"], chunks["count"]) + rows["index"]
        items["end"][-1] = 1
        tested.append(items)
        for begin, count in zip(chosen["first"].tolist(), chosen["count"].tolist(), strict=True):
            per_beat = 2 if config.compact else 1
            asked = np.arange(begin // per_beat, (begin + count - 1) // per_beat + 1)
            reads.append(asked)
            beats.append(memory[asked])
            points.append(rows[begin - first : begin - first + count])
        points.append(_ending(config))
    if not ends:
        tested[-1], points[-1] = tested[-1][:-1], points[-1][:0]
    request = np.zeros(sum(map(len, reads)), read_request(config).dtype)
    answer = np.zeros(len(request), read_data(config).dtype)
    if len(request):
        request["beat"] = base + np.concatenate(reads)
        answer["word"] = np.concatenate(beats).view("<u4")
        answer["error"][rng.integers(0, len(request))] = bad
    wanted = np.concatenate(points)
    return Case(name, {"tested": np.concatenate(tested), "data": answer}, {"reads": request, "points": wanted}, bad,
                int((wanted["end"] == 0).sum()), base, not ends)


def boundary_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Every number of Gaussians of a chunk, at even and odd indices; chunks of one; none at all; gaps; the coarse bound alone;
    an error of the memory."""
    lengths = list(range(1, CHUNK + 1))
    cases = [case(config, rng, f"every length from {first}", [lengths, lengths[::-1]], first=first) for first in (0, 1, 12345)]
    cases += [
        case(config, rng, "chunks of one", [[1] * 200]), case(config, rng, "chunks of one from 1", [[1] * 31, [1]], first=1),
        case(config, rng, "no chunks", [[]]), case(config, rng, "none, then some, then none", [[], [5, 3, 64], [], [1]]),
        case(config, rng, "odd chunks", [[63] * 20, [3, 5, 7, 9] * 10], first=1),
        case(config, rng, "half of the chunks", [rng.integers(1, CHUNK + 1, 60), rng.integers(1, 6, 200)], read=0.5),
        case(config, rng, "no chunk is read", [[64] * 9, [64] * 3], read=0.0),
        case(config, rng, "an error", [[64] * 9], bad=True),
    ]
    return cases
