"""The memory map of a frame, and the records on the machine's memory ports.

All data moves in beats of 32 bytes, one LPDDR3 burst each, and every transaction is one beat. The regions are:

    chunks      ChunkHeader, one beat per chunk; only machines with chunks read it
    geometry    GaussianGeometry, one beat per Gaussian, by index; with compact records CompactGeometry, half a beat
    colour      GaussianColour, `colour_beats` beats per Gaussian, by index; with compact records CompactColour, one beat, and
                CompactHarmonics, one beat, where the model has harmonics
    tiles       TileSetting, 8 bytes per tile, row-major; the host writes this table for each gaze
    supertiles  with lists by super-tile, the same settings once more: SUPER_TILES of each super-tile, row-major; super-tiles
                row-major, too; tiles beyond the frame are 0; in joint frames (`spec.joint`) those of the source's tiles of each
                joint super-tile, and those of the target's behind them
    views       splat records (SplatRecord), one beat each; that of Gaussian i for tiles of level L lies at beat
                (i << view_shift) + L; only Gaussians with an intersection have any; machines with lists by super-tile have none
    entries     intersections (Intersection), 8 bytes each, in pages by tile; a directory of those pages has its own base; with
                lists by super-tile, pairs in pages by list (`spec.supertiles`)
    spill       sorted runs of groups larger than the sort buffer
    frame       FramePixel, 16 bytes per pixel, or DisplayPixel, 4 bytes per pixel, as `display` says; row-major;
                or with `packed` a packed frame (`spec.packed`)

A frame of two eyes has a second table and a second frame, of DisplayPixels, for the target eye. Splat records, intersections
and spilled runs of the target eye replace those of the source eye, in the same regions. A joint frame has a second table and a
second frame, too, whose pixels have the format of the source's.

**Pages.** The intersections of a tile fill pages of doubling size: page k holds FIRST_PAGE_ENTRIES << k of them. Intersection
number n of a tile lies in page k, where k is the position of the top bit of (n + FIRST_PAGE_ENTRIES) / FIRST_PAGE_ENTRIES, at
position n + FIRST_PAGE_ENTRIES - (size of page k) of the page. Page 0 of tile t has a fixed place, 8 t beats from the base. The
other pages are allocated behind all first pages, in order of need; the first beat of page k, relative to the base, is written
into the tile's directory, 4 bytes at 4 (k - 1). So an intersection is written once and read once, a tile's list is read without
following links, and a long list wastes at most about half of its allocated space.
"""

from __future__ import annotations

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES, SUPER_X
from spec.formats import SQ
from spec.records import COUNT_BITS, INDEX_BITS, Field, Record, gaussian_colour, uint
from spec.stereo import DISPARITY_SCALE_BITS

BEAT_BYTES = 32
"""Bytes of a transaction: the AXI data width, and one burst of 8 of an LPDDR3 x32 channel."""

WORD_BITS = 32
"""Bits of a word, the unit in which the host sees memory."""

WORDS = 8 * BEAT_BYTES // WORD_BITS
"""Words of a beat."""

ADDRESS_BITS = 32
"""Bits of a byte address."""

BEAT_BITS = ADDRESS_BITS - (BEAT_BYTES - 1).bit_length()
"""Bits of a beat address."""

BEAT_ENTRIES = BEAT_BYTES // ENTRY_BYTES
"""Intersections per beat."""

FIRST_PAGE_ENTRIES = 32
"""Intersections in a tile's first page."""

FIRST_PAGE_BEATS = FIRST_PAGE_ENTRIES // BEAT_ENTRIES
"""Beats of a tile's first page, and of the unit in which pages are allocated: a page is a power of two of units long."""

DIRECTORY_SLOTS = 16
"""Pages of a tile beyond its first. With them a tile has space for 4,194,272 intersections."""

DIRECTORY_BEATS = DIRECTORY_SLOTS * 4 // BEAT_BYTES
"""Beats of a tile's directory."""

TILE_ENTRIES_MOST = (FIRST_PAGE_ENTRIES << DIRECTORY_SLOTS + 1) - FIRST_PAGE_ENTRIES
"""Intersections that all pages of a tile hold."""

SHIFT_BITS = SUPER_X.bit_length() + 1
"""Bits of the setting `shift`, which holds -SUPER_X..SUPER_X."""

TILE_SETTING_BYTES = 8
"""Bytes of a TileSetting in the host's table."""

PIXEL_BYTES = 16
"""Bytes of a FramePixel in memory."""

DISPLAY_PIXEL_BYTES = 4
"""Bytes of a DisplayPixel in memory."""

BUS_BYTES_PER_CYCLE = 2 * BEAT_BYTES
"""Most bytes that the bus moves in a cycle: a beat read and a beat written."""

DRAM_BYTES_PER_CYCLE = 25.6
"""Bandwidth of the paper's memory, four LPDDR3-1600 x32 channels, in bytes per cycle of the machine's 1 GHz clock."""


def entry_page(number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(page, place in the page), int64, of a tile's intersections by their number in the tile's list (any shape)."""
    place = np.asarray(number, np.int64) + FIRST_PAGE_ENTRIES
    page = np.frexp(place // FIRST_PAGE_ENTRIES)[1].astype(np.int64) - 1
    return page, place - (FIRST_PAGE_ENTRIES << page)


def pages_beyond_first(counts: np.ndarray) -> np.ndarray:
    """int64: how many pages tiles with so many intersections have beyond their first (any shape)."""
    return entry_page(np.maximum(np.asarray(counts, np.int64) - 1, 0))[0]


def page_beats(counts: np.ndarray) -> int:
    """Beats of all pages of tiles with so many intersections, (tiles,); a tile without any has its first page, too.

    Raises:
        ValueError: a tile has more intersections than its pages can hold.
    """
    counts = np.asarray(counts, np.int64)
    if len(counts) and counts.max() > TILE_ENTRIES_MOST:
        raise ValueError(f"counts must be at most {TILE_ENTRIES_MOST} entries a tile, not {int(counts.max())!r}")
    return FIRST_PAGE_BEATS * int(((2 << pages_beyond_first(counts)) - 1).sum())


def beat(name: str) -> Field:
    """A field that holds the address of a beat."""
    return Field(name, uint(BEAT_BITS), "beat address")


def read_request(config: AcceleratorConfig) -> Record:
    """A request to read one beat."""
    return Record("ReadRequest", read_request.__doc__, (beat("beat"),))


def read_data(config: AcceleratorConfig) -> Record:
    """A beat that was read. Beats come in the order of their requests."""
    return Record("ReadData", read_data.__doc__, (
        Field("word", uint(32), "the beat, lowest address first", WORDS),
        Field("error", uint(1), "the memory answered with an error; the words mean nothing"),
    ))


def write_request(config: AcceleratorConfig) -> Record:
    """A request to write words of one beat."""
    return Record("WriteRequest", write_request.__doc__, (
        beat("beat"),
        Field("word", uint(32), "the beat, lowest address first", WORDS),
        Field("strobe", uint(WORDS), "one bit per word: whether it is written"),
    ))


def tile_setting(config: AcceleratorConfig) -> Record:
    """A tile in the host's table: its level and how it blends."""
    return Record("TileSetting", tile_setting.__doc__, (
        Field("plane", config.formats.plane, "blend parameter at the first pixel, its slope along x, along y", 3),
        Field("level", uint(2), "level of the tile, 0..3"),
        Field("blend", uint(1), "the tile blends its level with the next"),
        *([Field("warp", uint(1), "target eye: the tile may be warped; 0: it must be rendered. Source eye: 0, ignored")]
          if config.stereo else []),
    ))


def splat_record(config: AcceleratorConfig) -> Record:
    """The splat record: what the array needs of a splat in tiles of one level. It takes one beat."""
    n = config.formats
    return Record("SplatRecord", splat_record.__doc__, (
        Field("mean2d", n.mean2d, "projected mean in pixels: x, y", 2),
        Field("conic", n.conic, "Cholesky factors l1, l2, l3: u = l1 dx + l2 dy, v = l3 dy", 3),
        Field("log2_opacity", n.log2_opacity, "log2 of the opacity at the level, at the next (the last has itself)", 2),
        Field("colour", n.colour, "r, g, b at the level, at the next (the last has itself)", 6),
        Field("depth", n.depth, "z as a fraction of the frame's depth scale"),
        Field("bound", uint(2), "quality bound m - 1"),
    ))


def frame_pixel(config: AcceleratorConfig) -> Record:
    """A pixel in memory with the array's sums unchanged, in fields that software reads without shifting."""
    return Record("FramePixel", frame_pixel.__doc__, (
        Field("colour", uint(16), "r, g, b: raw `accumulator`, background included", 3),
        Field("transmittance", uint(16), "raw `transmittance` that is left at the end; coverage is 1 minus it"),
        Field("depth", uint(32), "raw `depth_accumulator`: sum of weight * depth, not yet divided by the coverage"),
        Field("reserved", uint(32), "0"),
    ))


def display_pixel(config: AcceleratorConfig) -> Record:
    """A pixel in memory with 8 bits per channel, as displays take it. rs(x, f) is x / 2^f rounded half up."""
    return Record("DisplayPixel", display_pixel.__doc__, (
        Field("colour", uint(8), "r, g, b, background included: min(255, rs(255 raw, `accumulator` fraction bits))", 3),
        Field("coverage", uint(8), "255 - rs(255 raw `transmittance`, its fraction bits)"),
    ))


def colour_beats(config: AcceleratorConfig, sh_degree: int) -> int:
    """Beats of a Gaussian in the region `colour`: 1, 2, 2, 3 for SH degree 0, 1, 2, 3; with compact records 1, 2, 2, 2."""
    if config.compact:
        return 1 + (sh_degree > 0)
    return -(-gaussian_colour(config, sh_degree).width // (8 * BEAT_BYTES))


def frame_settings(config: AcceleratorConfig) -> Record:
    """The settings of a frame, which the host writes. Every number has a register of its own, in this order."""
    n = config.formats
    size = uint(14)
    return Record("FrameSettings", frame_settings.__doc__, (
        Field("position", n.view, "camera centre relative to the model's origin", 3),
        Field("rotation", n.view, "world to camera, row-major, its first two rows times the focal lengths", 9),
        Field("turn", n.work, "`rotation` divided by EXPONENT_SCALE, in the work format, for the Jacobian", 9),
        Field("centre", n.mean2d, "cx, cy in pixels", 2),
        Field("limits", n.view, "clamp of fx x/z (low, high) and of fy y/z (low, high) in pixels", 4),
        Field("near", n.view, "z of the near plane in world units"),
        Field("depth_scale", n.view, "reciprocal of the z at which depth saturates"),
        Field("width", size, "frame width in pixels"),
        Field("height", size, "frame height in pixels"),
        Field("background", n.colour, "r, g, b", 3),
        Field("gaussians", uint(INDEX_BITS), "number of Gaussians of the model"),
        Field("sh_degree", uint(2), "SH degree of the colour records"),
        *([] if config.supertiles else [_view_shift()]),
        Field("beta", uint(COUNT_BITS), "merge threshold in intersections; 0 merges nothing"),
        Field("auto_beta", uint(1), "1: twice the mean number of intersections of a tile replaces beta"),
        Field("obb", uint(1), "1: the tile test uses oriented bounding boxes instead of exact ellipses"),
        beat("geometry_base"), beat("colour_base"), beat("tiles_base"), *([] if config.supertiles else [beat("views_base")]),
        beat("directory_base"), beat("entries_base"),
        Field("entries_beats", uint(BEAT_BITS), "size of the region of intersections in beats"),
        beat("spill_base"),
        Field("spill_beats", uint(BEAT_BITS), "size of the region of spilled runs in beats"),
        Field("display", uint(1), "1: the frame consists of DisplayPixels; 0: of FramePixels"),
        beat("frame_base"),
        *(_chunk_settings(config) if config.chunks else ()),
        *(_stereo_settings(config) if config.stereo else _target_settings(config) if config.joint else ()),
        *([beat("supertiles_base")] if config.supertiles else []),
        *([Field("packed", uint(1), "1: the frame of DisplayPixels is packed (`spec.packed`)")] if config.packed else []),
        *(_joint_settings() if config.joint else ()),
        *([Field("second_sweep", uint(1), "1: where the target is warped, its tiles with holes are rendered in a second sweep; "
                 "0: the holes stay (`spec.joint_warp`)")] if config.warps_joint else []),
    ))


def _view_shift() -> Field:
    return Field("view_shift", uint(2),
                 "each Gaussian has space for 1 << view_shift splat records; at least the highest tile level + 1")


def _chunk_settings(config: AcceleratorConfig) -> tuple[Field, ...]:
    """Additional settings of machines with chunks."""
    return (
        Field("chunks", uint(INDEX_BITS), "number of chunks of the model"), beat("chunks_base"),
        Field("reach", config.formats.view, "pixels that a standard deviation of 1 at z = 1 reaches, along x, along y "
              "(`spec.chunks`)", 2),
    )


def _target_settings(config: AcceleratorConfig) -> tuple[Field, ...]:
    """Settings of the target eye."""
    return (
        Field("target_position", config.formats.view, "the target eye's centre relative to the model's origin", 3),
        beat("target_tiles_base"), beat("target_frame_base"),
    )


def _stereo_settings(config: AcceleratorConfig) -> tuple[Field, ...]:
    """Additional settings of a frame of two eyes; all other settings hold for both eyes."""
    position, *bases = _target_settings(config)
    return (
        Field("stereo", uint(1), "1: a frame of two eyes, of which the second is warped; 0: no eye is warped"),
        Field("source_right", uint(1), "1: the source eye is the right one"), position,
        Field("disparity_scale", uint(DISPARITY_SCALE_BITS),
              "disparity where depth saturates, in units of 2^-14 pixels (`spec.stereo.DISPARITY_SCALE_FRAC`)"), *bases)


def _joint_settings() -> tuple[Field, ...]:
    """Additional settings of a joint frame (`spec.joint`), which has those of the target eye as well."""
    return (
        Field("joint", uint(1), "1: a joint frame of two eyes; 0: a frame of one eye, which ignores the settings of the target "
              "and those below"),
        Field("shift", SQ(SHIFT_BITS - 1, 0), "tiles by which the source's points lie further right in the target "
              "(`spec.joint`)"),
        Field("shared_colour", uint(1), "1: the target has the source's colours; 0: each eye has its own"))


def _size(record: Record, limit: int) -> None:
    if record.width > limit:
        raise ValueError(f"{record.name} must fit {limit} bits, not {record.width!r}")


def check_memory(config: AcceleratorConfig) -> None:
    """Raises ValueError where a record with the config's formats does not fit its place in memory."""
    _size(splat_record(config), 8 * BEAT_BYTES)
    _size(tile_setting(config), 8 * TILE_SETTING_BYTES)


MEMORY_RECORDS = (
    read_request, read_data, write_request, tile_setting, splat_record, frame_pixel, display_pixel, frame_settings)
