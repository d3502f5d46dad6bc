"""Encodes Gaussian words as compact records and decodes them (`spec.compact` has the formats).

Whoever reads compact records, the machine or this renderer, works with the decoded words; `decode_geometry` and `decode_colour`
define them bit by bit. Encoding rounds every number to the nearest code, ties to even.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.host.chunks import chunk_of, place, position_codes, strongest
from spec.compact import (
    BAND_BITS,
    BAND_EXPONENT_MOST,
    BANDS,
    COARSE_BOUND,
    DC_COARSE_SHIFT,
    DC_LOW,
    FINE_LEVELS,
    OPACITY_BITS,
    OPACITY_LOG2,
    OPACITY_ONE,
    OPACITY_STEP_LOG2,
    ROOT_BASE,
    ROOT_HALF,
    ROOT_SLOPE,
    SCALE_FRACTIONS,
    SCALE_STEPS_LOG2,
    compact_colour,
    compact_geometry,
    compact_harmonics,
    dc_bits,
    quaternion_bits,
    scale_bits,
)
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import BEAT_BYTES
from spec.packing import pack
from spec.records import gaussian_colour, gaussian_geometry
from spec.tables import log2_alpha_min

GEOMETRY_BYTES = BEAT_BYTES // 2
"""Bytes of a CompactGeometry in memory."""

_DC_RANGES = 4
_SCALE_STEPS = 1 << SCALE_STEPS_LOG2
_OPACITY_TABLE = np.array(OPACITY_LOG2, np.int64)


@dataclass(frozen=True)
class CompactWords:
    """The compact records of a model, by index.

    Fine and coarse records have the same fields; a fine one holds fewer levels. The arrays have the coarse records' shape, and
    what a fine record does not hold is 0.

    Attributes:
        config: the machine.
        coarse: (N,) bool, whether a record is coarse.
        geometry: (N,) records of `compact_geometry`'s dtype.
        colour: (N,) records of `compact_colour`'s dtype for coarse records.
        harmonics: (N,) records of `compact_harmonics`' dtype, or None for a model without harmonics.
    """

    config: AcceleratorConfig
    coarse: np.ndarray
    geometry: np.ndarray
    colour: np.ndarray
    harmonics: np.ndarray | None

    def geometry_bytes(self) -> np.ndarray:
        """(beats, BEAT_BYTES) uint8: the region `geometry`, two Gaussians in a beat; the last half may be 0."""
        halves = np.zeros((len(self.coarse) + len(self.coarse) % 2, GEOMETRY_BYTES), np.uint8)
        for coarse, rows in ((False, np.flatnonzero(~self.coarse)), (True, np.flatnonzero(self.coarse))):
            halves[rows] = pack(compact_geometry(self.config, coarse), self.geometry[rows], GEOMETRY_BYTES)
        return halves.reshape(-1, BEAT_BYTES)

    def colour_bytes(self) -> np.ndarray:
        """(beats, BEAT_BYTES) uint8: the region `colour`, one beat a Gaussian, or two with harmonics."""
        beats = np.zeros((len(self.coarse), 1 + (self.harmonics is not None), BEAT_BYTES), np.uint8)
        for coarse, rows in ((False, np.flatnonzero(~self.coarse)), (True, np.flatnonzero(self.coarse))):
            record = compact_colour(self.config, coarse)
            held = {f.name: self.colour[f.name][rows, : f.count] if f.count > 1 else self.colour[f.name][rows]
                    for f in record.fields}
            beats[rows, 0] = pack(record, held, BEAT_BYTES)
        if self.harmonics is not None:
            beats[:, 1] = pack(compact_harmonics(self.config), self.harmonics, BEAT_BYTES)
        return beats.reshape(-1, BEAT_BYTES)


def _coarse(chunks: np.ndarray) -> np.ndarray:
    """(N,) bool: whether a Gaussian's records are coarse."""
    return np.repeat(chunks["bound"] == COARSE_BOUND, chunks["count"])


def _round_shift(value: np.ndarray, bits: np.ndarray | int) -> np.ndarray:
    """rs(x, n) of `spec.compact`."""
    return np.asarray(value + (1 << np.asarray(bits) - 1) >> bits)


# Encoding


def _encode_scale(config: AcceleratorConfig, scale: np.ndarray, top: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, int]:
    """Codes (N, 3) of `scale` words below tops (N, 1) in 1/16 octave, and how many lie below the smallest code."""
    form = config.formats.scale
    mantissa, exponent = np.frexp(form.to_float(scale))
    steps = _SCALE_STEPS * (exponent + form.bias) + _SCALE_STEPS * np.log2(np.where(mantissa > 0, mantissa, 1.0))
    unit, zero = np.where(coarse, 2, 1), (1 << np.where(coarse, scale_bits(True), scale_bits(False))) - 1
    below = (8 * top - steps) / unit
    lowest = np.minimum(zero - 1, (8 * top - _SCALE_STEPS) // unit)  # below it a word is zero
    flushed = below - lowest > _SCALE_STEPS / unit  # less than half of the smallest scale: zero is nearer
    code = np.where((mantissa == 0) | flushed, zero, np.minimum(np.rint(below), lowest))
    return code.astype(np.int64), int(((mantissa > 0) & (np.rint(below) > lowest)).sum())


def _encode_quaternion(quat: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """(`largest` (N,), codes (N, 3)) of raw quaternions (N, 4), and how many codes did not fit. A quaternion of 0, which turns
    nothing, becomes 1."""
    raw = quat.astype(np.int64)
    largest = np.abs(raw).argmax(axis=1)
    rows = np.arange(len(raw))
    others = np.array([[k for k in range(4) if k != l] for l in range(4)])[largest]
    sign = np.where(raw[rows, largest] < 0, -1, 1)
    half = 1 << np.where(coarse, quaternion_bits(True), quaternion_bits(False)) - 1
    code = np.rint(raw[rows[:, None], others] * sign[:, None] * half / ROOT_HALF).astype(np.int64)
    return largest, np.minimum(code, half - 1), int((code > half - 1).sum())


def opacity_codes(config: AcceleratorConfig, log2_opacity: np.ndarray) -> np.ndarray:
    """int64: the nearest codes of raw `log2_opacity` (any shape): in alpha up to 1, in its logarithm above. What cannot be seen
    has code 0."""
    raw = np.asarray(log2_opacity, np.int64)
    linear = np.rint(OPACITY_ONE * np.exp2(np.minimum(raw, 0) / 2.0**config.formats.log2_opacity.frac_bits)).astype(np.int64)
    above = np.minimum(OPACITY_ONE + np.rint(raw / (1 << OPACITY_STEP_LOG2)).astype(np.int64), (1 << OPACITY_BITS) - 1)
    return np.where(raw < log2_alpha_min(config.formats), 0, np.where(raw > 0, above, np.maximum(linear, 1)))


def _encode_dc(dc: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(`dc_range` (N,), codes like `dc`) of raw `sh_dc` (N, 3 levels): each range is the smallest that fits."""
    shift, most = np.where(coarse, DC_COARSE_SHIFT, 0), (1 << np.where(coarse, dc_bits(True), dc_bits(False))) - 1
    best, codes = np.full(len(dc), -1), np.zeros(dc.shape, np.int64)
    for r in range(_DC_RANGES):
        code = np.rint((dc.astype(np.int64) + (DC_LOW << r)) / (1 << r + shift)).astype(np.int64)
        fits = (best < 0) & ((code >= 0) & (code <= most)).all(axis=1)
        best[fits], codes[fits] = r, code[fits]
    return best, codes


def _encode_harmonics(config: AcceleratorConfig, rest: np.ndarray) -> tuple[np.ndarray, int]:
    """(N,) records of `compact_harmonics` of raw `sh_rest` (N, K), each band with the smallest exponent that fits, and how many
    coefficients lie beyond the codes of the largest exponent."""
    out, clipped = np.zeros(len(rest), compact_harmonics(config).dtype), 0
    for band, (terms, bits, most) in enumerate(zip(BANDS, BAND_BITS, BAND_EXPONENT_MOST, strict=True)):
        raw = rest[:, 3 * terms.start : 3 * terms.stop].astype(np.int64)
        if not raw.shape[1]:
            continue
        low, high = -(1 << bits - 1), (1 << bits - 1) - 1
        exponent = np.zeros(len(raw), np.int64)
        for _ in range(most):
            step = 1 << exponent
            exponent += (np.rint(raw.max(axis=1) / step) > high) | (np.rint(raw.min(axis=1) / step) < low)
        code = np.rint(raw / (1 << exponent)[:, None])
        out["exponent"][:, band] = exponent
        out[f"degree_{band + 1}"] = np.clip(code, low, high)
        clipped += int(((code < low) | (code > high)).sum())
    return out, clipped


def encode(
    config: AcceleratorConfig, chunks: np.ndarray, geometry: np.ndarray, colour: np.ndarray, sh_degree: int,
) -> tuple[CompactWords, dict[str, int]]:
    """The compact records of a model, and how many numbers no code could hold, by field.

    Levels above a Gaussian's bound, which no tile reads, get the codes of the highest one in use, so that they cost no range.

    Args:
        config: the machine.
        chunks: headers; all but `opacity` is used.
        geometry, colour: (N,) wide records in their order in memory.
        sh_degree: degree of the colour records.

    Returns:
        The records, and by field: `scale_floor`, standard deviations above 0 and below the smallest code, which become the
        smallest or 0; `quaternion`, components that round up to the root of 1/2; `harmonics`, coefficients near the end of
        their format.
    """
    n, chunk, coarse = config.formats, chunk_of(chunks), _coarse(chunks)
    of = chunks[chunk]
    column = coarse[:, None]
    g = np.zeros(len(geometry), compact_geometry(config, coarse=True).dtype)
    low, step = n.position.to_float(of["low"]), of["step"].astype(np.int64)
    g["position"] = position_codes(low, step, n.position.to_float(geometry["mean"]))
    g["scale"], floor = _encode_scale(config, geometry["scale"], of["scale_top"].astype(np.int64)[:, None], column)
    g["largest"], g["quaternion"], clipped = _encode_quaternion(geometry["quat"], column)
    g["opacity"] = opacity_codes(config, strongest(config, geometry))

    c = np.zeros(len(colour), compact_colour(config, coarse=True).dtype)
    for name in ("position", "scale", "largest", "quaternion"):
        c[name] = g[name]
    level = np.minimum(np.arange(MAX_LEVELS), geometry["bound"].astype(np.int64)[:, None])
    rows = np.arange(len(colour))[:, None]
    dc = colour["dc"].reshape(-1, MAX_LEVELS, 3)[rows, level].reshape(-1, 3 * MAX_LEVELS)
    if not sh_degree:  # nothing is added to a base colour that is clamped, so that no range needs to hold what lies beyond
        dc = np.clip(dc, 0, 1 << n.sh_dc.frac_bits + n.colour.int_bits)
    c["opacity"] = opacity_codes(config, geometry["log2_opacity"][rows, level])
    c["dc_range"], c["dc"] = _encode_dc(dc, column)
    c["opacity"][~coarse, FINE_LEVELS:] = 0
    c["dc"][~coarse, 3 * FINE_LEVELS :] = 0
    harmonics, beyond = _encode_harmonics(config, colour["rest"]) if sh_degree else (None, 0)
    return CompactWords(config, coarse, g, c, harmonics), {
        "scale_floor": floor, "quaternion": clipped, "harmonics": beyond}


# Decoding


def _decode_scale(config: AcceleratorConfig, code: np.ndarray, top: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """`scale` words, int64, of codes (N, 3)."""
    c = 8 * top - (code << coarse)
    zero = (code == (1 << np.where(coarse, scale_bits(True), scale_bits(False))) - 1) | (c < _SCALE_STEPS)
    fractions = np.array(SCALE_FRACTIONS, np.int64)
    word = (c >> SCALE_STEPS_LOG2) << config.formats.scale.sig_bits - 1 | fractions[c & _SCALE_STEPS - 1]
    return np.where(zero, 0, word)


def _decode_quaternion(largest: np.ndarray, code: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """Raw quaternions (N, 4), int64."""
    q = _round_shift(code * ROOT_HALF, np.where(coarse, quaternion_bits(True), quaternion_bits(False)) - 1)
    x = np.maximum((1 << 26) - (q * q).sum(axis=1), 1 << 24)
    segment, inside = (x >> 20) - 16, x >> 12 & 255
    base, slope = np.array(ROOT_BASE, np.int64), np.array(ROOT_SLOPE, np.int64)
    root = np.minimum(_round_shift(32 * base[segment] + slope[segment] * inside, 8), 8191)
    rows, place_of = np.arange(len(q)), np.arange(3)
    out = np.zeros((len(q), 4), np.int64)
    out[rows[:, None], place_of + (place_of >= largest[:, None])] = q
    out[rows, largest] = root
    return out


def decoded_opacity(code: np.ndarray) -> np.ndarray:
    """int64 raw `log2_opacity` of opacity codes (any shape)."""
    code = np.asarray(code, np.int64)
    return np.where(code <= OPACITY_ONE, _OPACITY_TABLE[np.minimum(code, OPACITY_ONE)],
                    code - OPACITY_ONE << OPACITY_STEP_LOG2)


def _levels(values: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """Values by level (N, MAX_LEVELS, ...) with the fourth of fine records replaced by the third."""
    values = values.copy()
    values[~coarse, FINE_LEVELS:] = values[~coarse, FINE_LEVELS - 1 : FINE_LEVELS]
    return values


def decode_shape(config: AcceleratorConfig, chunks: np.ndarray, records: np.ndarray) -> dict[str, np.ndarray]:
    """`mean`, `scale` and `quat` of wide words, by G or R (N,): both have the same fields for them.

    Args:
        config: the machine.
        chunks: the headers.
        records: (N,) `geometry` or `colour` of `CompactWords`.
    """
    of, coarse = chunks[chunk_of(chunks)], _coarse(chunks)[:, None].astype(np.int64)
    code = {name: records[name].astype(np.int64) for name in ("position", "scale", "largest", "quaternion")}
    low, step = config.formats.position.to_float(of["low"]), of["step"].astype(np.int64)
    mean = config.formats.position.quantise(place(config, low, step, code["position"]))
    return {"mean": mean, "scale": _decode_scale(config, code["scale"], of["scale_top"].astype(np.int64)[:, None], coarse),
            "quat": _decode_quaternion(code["largest"], code["quaternion"], coarse)}


def decode(config: AcceleratorConfig, chunks: np.ndarray, words: CompactWords, sh_degree: int) -> tuple[np.ndarray, np.ndarray]:
    """(geometry, colour): the wide records that compact ones stand for.

    Args:
        config: the machine.
        chunks: the headers.
        words: the compact records.
        sh_degree: degree of the colour records to make, at most that of the model.
    """
    coarse = _coarse(chunks)
    geometry = np.zeros(len(coarse), gaussian_geometry(config).dtype)
    for name, raw in decode_shape(config, chunks, words.geometry).items():
        geometry[name] = raw
    geometry["bound"] = np.repeat(chunks["bound"], chunks["count"])
    geometry["log2_opacity"] = _levels(decoded_opacity(words.colour["opacity"]), coarse)

    n = config.formats
    colour = np.zeros(len(coarse), gaussian_colour(config, sh_degree).dtype)
    r = words.colour["dc_range"].astype(np.int64)[:, None]
    code = words.colour["dc"].astype(np.int64)
    dc = np.minimum((code << r + np.where(coarse, DC_COARSE_SHIFT, 0)[:, None]) - (DC_LOW << r), n.sh_dc.raw_max)
    colour["dc"] = _levels(dc.reshape(-1, MAX_LEVELS, 3), coarse).reshape(-1, 3 * MAX_LEVELS)
    for band, terms in enumerate(BANDS[:sh_degree]):
        exponent = np.minimum(words.harmonics["exponent"][:, band].astype(np.int64)[:, None], BAND_EXPONENT_MOST[band])
        codes = words.harmonics[f"degree_{band + 1}"].astype(np.int64)
        colour["rest"][:, 3 * terms.start : 3 * terms.stop] = codes << exponent
    return geometry, colour


def with_sh_degree(words: CompactWords, degree: int, present: bool) -> CompactWords:
    """The records with no harmonics above a degree, which is at most the model's; with `present`, there are harmonics even of
    degree 0, which are 0."""
    if not present:
        return replace(words, harmonics=None)
    harmonics = np.zeros(len(words.coarse), compact_harmonics(words.config).dtype)
    if words.harmonics is not None:
        harmonics["exponent"][:, :degree] = words.harmonics["exponent"][:, :degree]
        for band in range(1, degree + 1):
            harmonics[f"degree_{band}"] = words.harmonics[f"degree_{band}"]
    return replace(words, harmonics=harmonics)


def with_first_level(words: CompactWords) -> CompactWords:
    """The records with the opacity and the base colour of the first level for all levels that they hold."""
    geometry, colour = words.geometry.copy(), words.colour.copy()
    held = np.where(words.coarse, MAX_LEVELS, FINE_LEVELS)[:, None] > np.arange(MAX_LEVELS)
    geometry["opacity"] = colour["opacity"][:, 0]
    colour["opacity"] = np.where(held, colour["opacity"][:, :1], 0)
    colour["dc"] = np.where(np.repeat(held, 3, axis=1), np.tile(colour["dc"][:, :3], (1, MAX_LEVELS)), 0)
    return replace(words, geometry=geometry, colour=colour)
