"""Stimuli of the colour unit: splats that survived culling, and their colour records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from golden.host.compact import CompactWords, decode
from golden.msv2_ref.colour import survivor_records
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import projected_splats
from golden.msv2_ref.tile_test import tile_test
from spec.chunks import chunk_header
from spec.compact import (
    BAND_BITS,
    COARSE_BOUND,
    FINE_LEVELS,
    OPACITY_BITS,
    compact_colour,
    compact_geometry,
    compact_harmonics,
    dc_bits,
    levels_held,
)
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, MAX_SH_DEGREE
from spec.formats import Fixed
from spec.harmonics import SEED_INDEX_BITS
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
        records: for each frame, (N,) records of degree `sh_degree`: GaussianColour, or `CompactWords`.
        sh_degree, colour_base, views_base, view_shift: the unit's settings.
        bad: positions in the last frame's beats of those that the memory answers with an error.
    """

    name: str
    frames: Sequence[np.ndarray]
    records: Sequence[np.ndarray | CompactWords]
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
        image = np.concatenate([
            compact_beats(records) if isinstance(records, CompactWords) else wide_beats(config, records, self.sh_degree)
            for records in self.records])
        data = np.zeros(len(image), read_data(config).dtype)
        data["word"] = words_of(image)
        bad = len(data) - colour_beats(config, self.sh_degree) * len(self.frames[-1]) + np.asarray(self.bad, np.int64)
        data["error"][bad] = 1
        end = np.zeros(1, surviving_splat(config).dtype)
        end["end"] = 1
        return {"survivors": np.concatenate([item for frame in self.frames for item in (frame, end)]), "data": data}

    def expected(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """Rows of the output streams."""
        splats, opacity = np.concatenate(self.frames), None
        if config.compact:
            geometry, colour = zip(*(decoded(records, self.sh_degree) for records in self.records), strict=True)
            records, opacity = np.concatenate(colour), np.concatenate(geometry)["log2_opacity"]
        else:
            records = np.concatenate(self.records)
        beats = colour_beats(config, self.sh_degree)
        reads = np.zeros(len(splats) * beats, read_request(config).dtype)
        place = self.colour_base + splats["index"].astype(np.int64)[:, None] * beats + np.arange(beats)
        reads["beat"] = place.reshape(-1) & ((1 << BEAT_BITS) - 1)
        views, place = survivor_records(config, splats, records, self.sh_degree, self.view_shift, opacity)
        writes = np.zeros(len(views), write_request(config).dtype)
        writes["beat"], writes["strobe"] = (self.views_base + place) & ((1 << BEAT_BITS) - 1), (1 << WORDS) - 1
        patterns = pack(splat_record(config), views)
        writes["word"] = words_of(np.pad(patterns, ((0, 0), (0, BEAT_BYTES - patterns.shape[1]))))
        return {"reads": reads, "writes": writes}


def words_of(beats: np.ndarray) -> np.ndarray:
    """(N, BEAT_BYTES) uint8 beats as (N, WORDS) uint32 words."""
    return np.ascontiguousarray(beats).view("<u4")


def wide_beats(config: AcceleratorConfig, records: np.ndarray, sh_degree: int) -> np.ndarray:
    """(beats, BEAT_BYTES) uint8: GaussianColour records in memory. Bits outside the records are ones."""
    record, beats = gaussian_colour(config, sh_degree), colour_beats(config, sh_degree)
    bits = np.unpackbits(pack(record, records), axis=1, bitorder="little")
    image = np.ones((len(bits), 8 * BEAT_BYTES * beats), np.uint8)
    image[:, : record.width] = bits[:, : record.width]
    return np.packbits(image, axis=1, bitorder="little").reshape(-1, BEAT_BYTES)


def compact_beats(words: CompactWords) -> np.ndarray:
    """(beats, BEAT_BYTES) uint8: compact records in memory. Bits outside the records are ones."""
    beats = words.colour_bytes().reshape(len(words.coarse), 1 + (words.harmonics is not None), BEAT_BYTES).copy()
    widths = np.where(words.coarse, compact_colour(words.config, True).width, compact_colour(words.config).width)
    beats[:, 0] |= _above(widths)
    if words.harmonics is not None:
        beats[:, 1] |= _above(np.full(len(beats), compact_harmonics(words.config).width))
    return beats.reshape(-1, BEAT_BYTES)


def _above(widths: np.ndarray) -> np.ndarray:
    """(N, BEAT_BYTES) uint8: ones in the bits of a beat from bit `widths` on."""
    return np.packbits(np.arange(8 * BEAT_BYTES) >= widths[:, None], axis=1, bitorder="little")


def decoded(words: CompactWords, sh_degree: int) -> tuple[np.ndarray, np.ndarray]:
    """(geometry, colour): wide records of compact ones, whose chunks do not matter here."""
    headers = np.zeros(len(words.coarse), chunk_header(words.config).dtype)
    headers["bound"], headers["count"], headers["first"] = COARSE_BOUND * words.coarse, 1, np.arange(len(headers))
    return decode(words.config, headers, words, sh_degree)


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
    if config.joint:
        rows["eye"] = 0
    return rows


def random_case(
    config: AcceleratorConfig, seed: int, sh_degree: int, counts: Sequence[int], *, name: str | None = None,
    levels: Sequence[int] = tuple(range(1, 1 << MAX_LEVELS)), bad: Sequence[int] = (),
) -> Case:
    """Random survivors in frames of these lengths. Most coefficients are small, some are arbitrary, and the settings are
    drawn."""
    rng, n = np.random.default_rng(seed), config.formats
    frames = [random_survivors(config, rng, count, levels) for count in counts]
    if config.compact:
        records = [compact_records(config, rng, rows["bound"], sh_degree) for rows in frames]
    else:
        records = [random_rows(rng, gaussian_colour(config, sh_degree), count) for count in counts]
    for rows in records if sh_degree and not config.compact else ():
        tame = rng.random(len(rows)) < 0.8
        scale = 0.15 * 2.0**n.sh_rest.frac_bits
        rows["rest"][tame] = np.rint(rng.normal(0, scale, rows["rest"][tame].shape)).clip(n.sh_rest.raw_min, n.sh_rest.raw_max)
    bases = {base: int(rng.integers(0, 1 << BEAT_BITS)) for base in ("colour_base", "views_base")}
    return Case(name or f"random of degree {sh_degree}", frames, records, sh_degree, **bases,
                view_shift=int(rng.integers(0, 4)), bad=bad)


def compact_records(config: AcceleratorConfig, rng: np.random.Generator, bound: np.ndarray, sh_degree: int) -> CompactWords:
    """Random compact records of Gaussians with these bounds (N,). Half of the bands have small exponents."""
    coarse, count = bound == COARSE_BOUND, len(bound)
    colour = random_rows(rng, compact_colour(config, True), count)
    for f in compact_colour(config).fields:  # fine fields, where they are wider or fewer
        fine = rng.integers(*f.raw_range, (count, f.count), endpoint=True)
        if f.count == 1:
            colour[f.name] = np.where(coarse, colour[f.name], fine[:, 0])
            continue
        colour[f.name][~coarse] = 0
        colour[f.name][~coarse, : f.count] = fine[~coarse]
    harmonics = random_rows(rng, compact_harmonics(config), count) if sh_degree else None
    if harmonics is not None:
        tame = rng.random(harmonics["exponent"].shape) < 0.5
        harmonics["exponent"][tame] = rng.integers(0, 4, int(tame.sum()))
        for degree in range(sh_degree + 1, MAX_SH_DEGREE + 1):
            harmonics[f"degree_{degree}"] = 0
    return CompactWords(config, coarse, np.zeros(count, compact_geometry(config, True).dtype), colour, harmonics)


def _chosen(words: CompactWords, rng: np.random.Generator, sh_degree: int) -> None:
    """Sets all codes of a record to ends of their range, or near to 0."""
    count = len(words.coarse)
    for name, low, high in (
        ("dc", 0, np.where(words.coarse, (1 << dc_bits(True)) - 1, (1 << dc_bits(False)) - 1)),
        ("opacity", 0, np.full(count, (1 << OPACITY_BITS) - 1)),
    ):
        middle = (high >> 1) + rng.integers(-1, 2, count)
        value = np.choose(rng.integers(0, 3, count), [np.full(count, low), middle, high])[:, None]
        words.colour[name] = np.where(words.colour[name] >= 0, value, 0)
    for name in ("opacity", "dc"):
        held = FINE_LEVELS * (3 if name == "dc" else 1)
        words.colour[name][~words.coarse, held:] = 0
    if words.harmonics is None:
        return
    words.harmonics["exponent"] = rng.choice([0, 5, 7, 15], words.harmonics["exponent"].shape)
    sign = rng.integers(-1, 2, count)[:, None]
    for degree, bits in enumerate(BAND_BITS[:sh_degree], 1):
        top = 1 << bits - 1
        words.harmonics[f"degree_{degree}"] = np.where(sign > 0, top - 1, sign * top)


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
    if config.compact:
        words = compact_records(config, rng, rows["bound"], sh_degree)
        _chosen(words, rng, sh_degree)
        return Case(f"extremes of degree {sh_degree}", [rows], [words], sh_degree)
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
    if config.compact:
        for bits, mask in ((dc_bits(True), records.coarse), (dc_bits(False), ~records.coarse)):
            held = 3 * levels_held(bits == dc_bits(True))
            grey = rng.integers(1 << bits - 2, 3 << bits - 2, (int(mask.sum()), held))
            records.colour["dc"][mask, :held] = grey
        records.colour["dc_range"] = 0
        if sh_degree:
            records.harmonics["exponent"] = np.minimum(records.harmonics["exponent"], 6)
        return case
    records["dc"] = rng.integers(1 << n.sh_dc.frac_bits - 1, 3 << n.sh_dc.frac_bits - 1, records["dc"].shape)
    if sh_degree:
        records["rest"] = rng.integers(n.sh_rest.raw_min, n.sh_rest.raw_max + 1, records["rest"].shape)
    return case


def _beside_steps(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> np.ndarray:
    """(2 * count, 3) raw offsets whose squared lengths, as the unit rounds them, lie just beside a step of the table from which
    the unit takes roots; half of the steps are powers of two, where the unit scales the number."""
    view, one = config.formats.view, 1 << config.formats.sh_basis.frac_bits
    offset = view.quantise(rng.normal(size=(400_000, 3)) * 2.0 ** rng.integers(-8, 9, (400_000, 1)))
    exact = np.abs(view.to_float(offset))
    aligned = np.trunc(np.ldexp(exact, 1 - np.frexp(exact.max(axis=1))[1][:, None]) * one)
    length = np.floor(aligned**2 / one + 0.5).sum(axis=1).astype(np.int64)
    octaves = one << np.arange(4)
    found = []
    for steps in (octaves, (octaves + (octaves >> SEED_INDEX_BITS) * np.arange(1 << SEED_INDEX_BITS)[:, None]).T.reshape(-1)):
        after = np.searchsorted(steps, length, side="right")
        near = (length - steps[np.maximum(after - 1, 0)] < 5) | (np.append(steps, 16 * one)[after] - length < 5)
        found.append(offset[near & (length > octaves[0] + 5)][:count])
    return np.concatenate(found)


def limits_case(config: AcceleratorConfig, seed: int, sh_degree: int) -> Case:
    """`fine_case` with directions at the limits of the arithmetic: beside the steps of the root's table, and offsets of the
    smallest numbers that the format holds."""
    rng = np.random.default_rng((seed, sh_degree))
    offset = _beside_steps(config, rng, 150)
    tiny = rng.choice([-1, 1], (200, 3)) * np.ldexp(rng.uniform(1, 2, (200, 3)), config.formats.view.exp_min + rng.integers(
        0, 16, (200, 3)))
    offset = np.concatenate([offset, config.formats.view.quantise(tiny)])
    case = replace(fine_case(config, seed, sh_degree, len(offset)), name=f"limits of directions, degree {sh_degree}")
    case.frames[0]["offset"] = offset
    return case


def frame_case(name: str, frame: Frame) -> Case:
    """The survivors of a traced frame, with the colour records of its model."""
    config, registers, words = frame.config, frame.registers, frame.words
    splats = projected_splats(config, words, registers)[:-1]
    survivors = tile_test(config, splats, registers.header[:, :2], registers.width, registers.height).survivors[:-1]
    rows = survivors["index"]
    records = compact_rows(words.compact, rows) if config.compact else words.colour[rows]
    return Case(name, [survivors], [records], words.sh_degree, colour_base=1000, views_base=99_000)


def compact_rows(words: CompactWords, rows: np.ndarray) -> CompactWords:
    """The compact records of some Gaussians."""
    harmonics = None if words.harmonics is None else words.harmonics[rows]
    return CompactWords(words.config, words.coarse[rows], words.geometry[rows], words.colour[rows], harmonics)
