"""Stimuli of the colour unit: splats that survived culling, and their colour records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from golden.msv2_ref.colour import survivor_records
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import projected_splats
from golden.msv2_ref.tile_test import tile_test
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.formats import Fixed
from spec.memory import BEAT_BITS, BEAT_BYTES, WORDS, colour_beats, read_data, read_request, splat_record, write_request
from spec.packing import pack
from spec.records import INDEX_BITS, Record, gaussian_colour, surviving_splat

DIRECTIONS = np.array([
    (x, y, z) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) for z in (-1.0, 0.0, 1.0)])
"""The directions along the axes and the diagonals, and the zero vector."""


@dataclass(frozen=True)
class Case:
    """One frame, or several with the same settings.

    Attributes:
        name: the case's name, for messages.
        frames: for each frame, (N,) SurvivingSplat records without the `end` item.
        records: for each frame, (N,) GaussianColour records of degree `sh_degree`.
        sh_degree, colour_base, views_base, view_shift: the unit's settings.
        bad: positions in the last frame's beats of those that the memory answers with an error.
    """

    name: str
    frames: Sequence[np.ndarray]
    records: Sequence[np.ndarray]
    sh_degree: int
    colour_base: int = 0
    views_base: int = 0
    view_shift: int = 2
    bad: Sequence[int] = field(default=())

    @property
    def settings(self) -> dict[str, int]:
        """The unit's settings by name."""
        return {name: getattr(self, name) for name in ("sh_degree", "colour_base", "views_base", "view_shift")}

    @property
    def observed(self) -> dict[str, int]:
        """The values of the unit's plain outputs at the end."""
        return {"finished": 1, "error": int(len(self.bad) > 0)}

    def inputs(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """Rows of the input streams. The unused bits of a record's last beat are ones, so that a unit that reads them is wrong.
        Faulty beats carry the same data and the error flag."""
        record, beats = gaussian_colour(config, self.sh_degree), colour_beats(config, self.sh_degree)
        patterns = pack(record, np.concatenate(self.records))
        bits = np.unpackbits(patterns, axis=1, bitorder="little")
        image = np.ones((len(bits), 8 * BEAT_BYTES * beats), np.uint8)
        image[:, : record.width] = bits[:, : record.width]
        data = np.zeros(len(bits) * beats, read_data(config).dtype)
        data["word"] = words_of(np.packbits(image, axis=1, bitorder="little").reshape(-1, BEAT_BYTES))
        bad = len(data) - beats * len(self.frames[-1]) + np.asarray(self.bad, np.int64)
        data["error"][bad] = 1
        end = np.zeros(1, surviving_splat(config).dtype)
        end["end"] = 1
        return {"survivors": np.concatenate([item for frame in self.frames for item in (frame, end)]), "data": data}

    def expected(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """Rows of the output streams."""
        splats, records = np.concatenate(self.frames), np.concatenate(self.records)
        beats = colour_beats(config, self.sh_degree)
        reads = np.zeros(len(splats) * beats, read_request(config).dtype)
        place = self.colour_base + splats["index"].astype(np.int64)[:, None] * beats + np.arange(beats)
        reads["beat"] = place.reshape(-1) & ((1 << BEAT_BITS) - 1)
        views, place = survivor_records(config, splats, records, self.sh_degree, self.view_shift)
        writes = np.zeros(len(views), write_request(config).dtype)
        writes["beat"], writes["strobe"] = (self.views_base + place) & ((1 << BEAT_BITS) - 1), (1 << WORDS) - 1
        patterns = pack(splat_record(config), views)
        writes["word"] = words_of(np.pad(patterns, ((0, 0), (0, BEAT_BYTES - patterns.shape[1]))))
        return {"reads": reads, "writes": writes}


def words_of(beats: np.ndarray) -> np.ndarray:
    """(N, BEAT_BYTES) uint8 beats as (N, WORDS) uint32 words."""
    return np.ascontiguousarray(beats).view("<u4")


def random_rows(rng: np.random.Generator, record: Record, count: int) -> np.ndarray:
    """(count,) records with random bits in every field."""
    rows = np.zeros(count, record.dtype)
    for f in record.fields:
        low, high = f.raw_range if isinstance(f.format, Fixed) else (0, (1 << f.format.width) - 1)
        rows[f.name] = rng.integers(low, high + 1, rows[f.name].shape)
    return rows


def random_survivors(config: AcceleratorConfig, rng: np.random.Generator, count: int, levels: Sequence[int]) -> np.ndarray:
    """(count,) random survivors with level masks drawn from `levels`. Their offsets have all directions and span many
    octaves."""
    rows = random_rows(rng, surviving_splat(config), count)
    rows["index"] = rng.integers(0, 1 << INDEX_BITS, count)
    offset = rng.normal(size=(count, 3)) * 2.0 ** rng.integers(-8, 9, (count, 1))
    offset *= np.where(rng.random((count, 3)) < 0.1, 2.0 ** rng.integers(-20, 0, (count, 3)), 1)
    rows["offset"], rows["levels"], rows["end"] = config.formats.view.quantise(offset), rng.choice(levels, count), 0
    return rows


def random_case(
    config: AcceleratorConfig, seed: int, sh_degree: int, counts: Sequence[int], *, name: str | None = None,
    levels: Sequence[int] = tuple(range(1, 1 << MAX_LEVELS)), bad: Sequence[int] = (),
) -> Case:
    """Random survivors in frames of these lengths. Most coefficients are small, some are arbitrary, and the settings are
    drawn."""
    rng, n = np.random.default_rng(seed), config.formats
    frames = [random_survivors(config, rng, count, levels) for count in counts]
    records = [random_rows(rng, gaussian_colour(config, sh_degree), count) for count in counts]
    for rows in records if sh_degree else ():
        tame = rng.random(len(rows)) < 0.8
        scale = 0.15 * 2.0**n.sh_rest.frac_bits
        rows["rest"][tame] = np.rint(rng.normal(0, scale, rows["rest"][tame].shape)).clip(n.sh_rest.raw_min, n.sh_rest.raw_max)
    bases = {base: int(rng.integers(0, 1 << BEAT_BITS)) for base in ("colour_base", "views_base")}
    return Case(name or f"random of degree {sh_degree}", frames, records, sh_degree, **bases,
                view_shift=int(rng.integers(0, 4)), bad=bad)


def extreme_case(config: AcceleratorConfig, sh_degree: int) -> Case:
    """Every direction of DIRECTIONS, nearest and farthest, with zero coefficients and the largest ones of either sign."""
    n, view = config.formats, config.formats.view
    record = gaussian_colour(config, sh_degree)
    ends = [(low, high) for high in (n.sh_dc.raw_min, -1, 0, 1, n.sh_dc.raw_max) for low in (
        n.sh_rest.raw_min, 0, n.sh_rest.raw_max)]
    scales = [2.0**-100, 1.0, 1.0 - 2.0**-view.sig_bits, view.max]
    offsets = np.concatenate([DIRECTIONS * scale for scale in scales])
    rng, count = np.random.default_rng(0), len(offsets) * len(ends)
    rows = random_survivors(config, rng, count, range(1 << MAX_LEVELS))
    rows["offset"] = view.quantise(np.repeat(offsets, len(ends), axis=0))
    records = np.zeros(count, record.dtype)
    which = np.array(ends)[np.arange(count) % len(ends)]
    records["dc"] = which[:, 1:]
    if sh_degree:
        records["rest"] = which[:, :1]
    return Case(f"extremes of degree {sh_degree}", [rows], [records], sh_degree)


def fine_case(config: AcceleratorConfig, seed: int, sh_degree: int, count: int) -> Case:
    """Large coefficients around a grey: few colours saturate, so they show every bit of the basis functions."""
    case, n = random_case(config, seed, sh_degree, [count], name=f"fine, degree {sh_degree}", levels=(1, 4)), config.formats
    rng, (records,) = np.random.default_rng(seed), case.records
    records["dc"] = rng.integers(1 << n.sh_dc.frac_bits - 1, 3 << n.sh_dc.frac_bits - 1, records["dc"].shape)
    if sh_degree:
        records["rest"] = rng.integers(n.sh_rest.raw_min, n.sh_rest.raw_max + 1, records["rest"].shape)
    return case


def frame_case(name: str, frame: Frame) -> Case:
    """The survivors of a traced frame, with the colour records of its model."""
    config, registers, words = frame.config, frame.registers, frame.words
    splats = projected_splats(config, words, registers)[:-1]
    survivors = tile_test(config, splats, registers.header[:, :2], registers.width, registers.height).survivors[:-1]
    return Case(name, [survivors], [words.colour[survivors["index"]]], words.sh_degree, colour_base=1000, views_base=99_000)
