"""What lies in memory besides the Gaussians, where, and what travels on the machine's memory ports.

Memory moves in beats of 32 bytes, one burst of LPDDR3 each; every transaction is one beat. Where things lie:

    geometry    GaussianGeometry, one beat a Gaussian, by index
    colour      GaussianColour, `colour_beats` beats a Gaussian, by index
    tiles       TileSetting, 8 bytes a tile, row-major: the host's, per gaze
    views       SplatView, one beat; of Gaussian i at tile level L at beat (i << view_shift) + L; written for survivors only
    entries     TileEntry, 8 bytes, in pages by tile; directory of those pages beside it
    spill       sorted runs of groups larger than the sort buffer
    frame       FramePixel, 16 bytes a pixel, or DisplayPixel, 4 bytes a pixel, as `display` says; row-major

A frame of two eyes has a table and a frame, of DisplayPixels, more: the target eye's. Views, entries and spill are the
target's after the source's, in the same places.

**Pages.** A tile's entries fill pages that double: page k has FIRST_PAGE_ENTRIES << k entries. Entry number n of a tile lies in
page k where k is the place of the top bit of (n + FIRST_PAGE_ENTRIES) / FIRST_PAGE_ENTRIES, at n + FIRST_PAGE_ENTRIES less the
page's size. Page 0 of tile t has its fixed place, 8 t beats from the base; the others are handed out from behind those, in
order of need, and their first beat (relative to the base) is written into the tile's directory, 4 bytes at 4 (k - 1).
So an entry is written once and read once, a tile's list is read without following links, and at most half of it is waste.
"""

from __future__ import annotations

from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.records import COUNT_BITS, INDEX_BITS, Field, Record, gaussian_colour, uint
from spec.stereo import DISPARITY_SCALE_BITS

BEAT_BYTES = 32
"""Bytes of a transaction: the AXI data width, and one LPDDR3 burst of eight transfers on a x32 channel."""

WORD_BITS = 32
"""A word, as the host sees memory."""

WORDS = 8 * BEAT_BYTES // WORD_BITS
"""Words of a beat, as records and the host see it."""

ADDRESS_BITS = 32
"""Byte addresses."""

BEAT_BITS = ADDRESS_BITS - (BEAT_BYTES - 1).bit_length()
"""Beat addresses."""

BEAT_ENTRIES = BEAT_BYTES // ENTRY_BYTES
"""Tile entries of a beat."""

FIRST_PAGE_ENTRIES = 32
"""Entries of a tile's first page."""

DIRECTORY_SLOTS = 16
"""Pages of a tile beyond its first: 4,194,272 entries in all."""

DIRECTORY_BEATS = DIRECTORY_SLOTS * 4 // BEAT_BYTES
"""Beats of a tile's directory."""

TILE_SETTING_BYTES = 8
"""A tile in the host's table."""

PIXEL_BYTES = 16
"""A FramePixel in memory."""

DISPLAY_PIXEL_BYTES = 4
"""A DisplayPixel in memory."""

DRAM_BYTES_PER_CYCLE = 25.6
"""The paper's memory at the machine's 1 GHz: four LPDDR3-1600 x32 channels."""


def beat(name: str) -> Field:
    """A field for the address of a beat."""
    return Field(name, uint(BEAT_BITS), "beat address")


def read_request(config: AcceleratorConfig) -> Record:
    """A beat wanted from memory."""
    return Record("ReadRequest", read_request.__doc__, (beat("beat"),))


def read_data(config: AcceleratorConfig) -> Record:
    """A beat from memory; beats come in the order of their requests."""
    return Record("ReadData", read_data.__doc__, (
        Field("word", uint(32), "the beat, lowest address first", WORDS),
        Field("error", uint(1), "the memory answered with an error; the words mean nothing"),
    ))


def write_request(config: AcceleratorConfig) -> Record:
    """A beat for memory."""
    return Record("WriteRequest", write_request.__doc__, (
        beat("beat"),
        Field("word", uint(32), "the beat, lowest address first", WORDS),
        Field("strobe", uint(WORDS), "which of the words are written"),
    ))


def tile_setting(config: AcceleratorConfig) -> Record:
    """A tile in the host's table: its level and how it blends."""
    return Record("TileSetting", tile_setting.__doc__, (
        Field("plane", config.formats.plane, "blend parameter at the first pixel, its slope along x, along y", 3),
        Field("level", uint(2), "level of the tile, 0..3"),
        Field("blend", uint(1), "the tile blends its level with the next"),
        *([Field("warp", uint(1), "in the target eye: no pixel of it must be rendered; 0, and ignored, in the source eye")]
          if config.stereo else []),
    ))


def splat_view(config: AcceleratorConfig) -> Record:
    """What the array wants of a splat in tiles of one level: one beat."""
    n = config.formats
    return Record("SplatView", splat_view.__doc__, (
        Field("mean2d", n.mean2d, "projected mean in pixels: x, y", 2),
        Field("conic", n.conic, "Cholesky factors l1, l2, l3: u = l1 dx + l2 dy, v = l3 dy", 3),
        Field("log2_opacity", n.log2_opacity, "log2 of the opacity at the level, at the next (the last has itself)", 2),
        Field("colour", n.colour, "r, g, b at the level, at the next (the last has itself)", 6),
        Field("depth", n.depth, "z as a fraction of the frame's depth scale"),
        Field("bound", uint(2), "quality bound m - 1"),
    ))


def frame_pixel(config: AcceleratorConfig) -> Record:
    """A pixel in memory: sums as the array leaves them, in fields that software reads without shifting."""
    return Record("FramePixel", frame_pixel.__doc__, (
        Field("colour", uint(16), "r, g, b: raw `accumulator`, background included", 3),
        Field("transmittance", uint(16), "raw `transmittance`: what is left at the end; coverage is 1 minus it"),
        Field("depth", uint(32), "raw `depth_accumulator`: sum of weight * depth, not yet divided by the coverage"),
        Field("reserved", uint(32), "0"),
    ))


def display_pixel(config: AcceleratorConfig) -> Record:
    """A pixel in memory as displays take it; 8 bits are round half up of 255 times the value, at most 255."""
    return Record("DisplayPixel", display_pixel.__doc__, (
        Field("colour", uint(8), "r, g, b, background included: min(255, rs(255 raw, `accumulator` fraction bits))", 3),
        Field("coverage", uint(8), "255 - rs(255 raw `transmittance`, its fraction bits)"),
    ))


def colour_beats(config: AcceleratorConfig, sh_degree: int) -> int:
    """Beats of a GaussianColour of that degree: 1, 2, 2, 3."""
    return -(-gaussian_colour(config, sh_degree).width // (8 * BEAT_BYTES))


def frame_settings(config: AcceleratorConfig) -> Record:
    """What the host sets for a frame; every number has a register of its own, in this order."""
    n = config.formats
    size = uint(14)
    return Record("FrameSettings", frame_settings.__doc__, (
        Field("position", n.view, "camera centre relative to the model's origin", 3),
        Field("rotation", n.view, "world to camera, row-major, its first two rows times the focal lengths", 9),
        Field("turn", n.work, "the same over EXPONENT_SCALE in the work format, for the Jacobian", 9),
        Field("centre", n.mean2d, "cx, cy in pixels", 2),
        Field("limits", n.view, "clamp of fx x/z (low, high) and of fy y/z (low, high) in pixels", 4),
        Field("near", n.view, "near plane"),
        Field("depth_scale", n.view, "reciprocal of the z that saturates depth"),
        Field("width", size, "frame width in pixels"),
        Field("height", size, "frame height in pixels"),
        Field("background", n.colour, "r, g, b", 3),
        Field("gaussians", uint(INDEX_BITS), "points of the model"),
        Field("sh_degree", uint(2), "degree of the colour records"),
        Field("view_shift", uint(2), "views of a Gaussian: 1 << view_shift, no fewer than the highest tile level + 1"),
        Field("beta", uint(COUNT_BITS), "merge threshold in entries; 0 merges nothing"),
        Field("auto_beta", uint(1), "twice the mean count instead of beta"),
        Field("obb", uint(1), "bounding boxes instead of the exact tile test"),
        beat("geometry_base"), beat("colour_base"), beat("tiles_base"), beat("views_base"), beat("directory_base"),
        beat("entries_base"),
        Field("entries_beats", uint(BEAT_BITS), "room for entries"),
        beat("spill_base"),
        Field("spill_beats", uint(BEAT_BITS), "room for spilled runs"),
        Field("display", uint(1), "the frame is of DisplayPixels instead of FramePixels"),
        beat("frame_base"),
        *(_stereo_settings(config) if config.stereo else ()),
    ))


def _stereo_settings(config: AcceleratorConfig) -> tuple[Field, ...]:
    """What a frame of two eyes takes besides; all other settings hold for both eyes."""
    return (
        Field("stereo", uint(1), "two eyes; 0: an ordinary frame, and the settings below mean nothing"),
        Field("source_right", uint(1), "the source eye is the right one"),
        Field("target_position", config.formats.view, "the target eye's centre relative to the model's origin", 3),
        Field("disparity_scale", uint(DISPARITY_SCALE_BITS),
              "disparity where depth saturates, in units of 2^-14 pixels (`spec.stereo.DISPARITY_SCALE_FRAC`)"),
        beat("target_tiles_base"), beat("target_frame_base"),
    )


def _size(record: Record, limit: int) -> None:
    if record.width > limit:
        raise ValueError(f"{record.name} must fit {limit} bits, not {record.width!r}")


def check_memory(config: AcceleratorConfig) -> None:
    """ValueError where the config's formats do not fit the places they have in memory."""
    _size(splat_view(config), 8 * BEAT_BYTES)
    _size(tile_setting(config), 8 * TILE_SETTING_BYTES)


MEMORY_RECORDS = (
    read_request, read_data, write_request, tile_setting, splat_view, frame_pixel, display_pixel, frame_settings)
