"""Layouts of all records that lie in memory or travel between units.

A record is a list of named fields, each a number format or a plain unsigned integer, packed from bit 0 up. `rtl.shapes`
turns a record into an Amaranth layout, `Record.pack` turns values into bit patterns, and `Record.dtype` is the numpy type in
which the golden renderer holds it. docs/formats.md is generated from this module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.formats import UQ, Fixed, Format


@dataclass(frozen=True)
class Field:
    """One field: `count` numbers of one format; raw integers for Fixed, bit patterns for SmallFloat."""

    name: str
    format: Format
    doc: str
    count: int = 1

    @property
    def width(self) -> int:
        """Bits of the whole field."""
        return self.format.width * self.count

    @property
    def holder(self) -> type[np.signedinteger]:
        """The smallest of int16, int32 and int64 that holds one number."""
        high = self.raw_range[1]
        return np.int16 if high < 1 << 15 else np.int32 if high < 1 << 31 else np.int64

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value of one number."""
        if isinstance(self.format, Fixed):
            return self.format.raw_min, self.format.raw_max
        return 0, (1 << self.format.width) - 1


@dataclass(frozen=True)
class Record:
    """A named layout. Field 0 sits in the lowest bits."""

    name: str
    doc: str | None
    fields: tuple[Field, ...]

    @property
    def width(self) -> int:
        """Bits of the record."""
        return sum(f.width for f in self.fields)

    @property
    def dtype(self) -> np.dtype:
        """Structured dtype of raw values (Fixed) or bit patterns (SmallFloat), each in the smallest of int16, int32, int64."""
        return np.dtype([(f.name, f.holder, (f.count,)) if f.count > 1 else (f.name, f.holder) for f in self.fields])

    def pack(self, row: Mapping[str, Any] | np.void) -> int:
        """The bit pattern of one row. Raises ValueError where a raw value, or the number of them, does not fit its field."""
        bits, offset = 0, 0
        for f in self.fields:
            numbers = np.atleast_1d(row[f.name]).tolist()
            if len(numbers) != f.count:
                raise ValueError(f"{self.name}.{f.name} must hold {f.count} numbers, not {len(numbers)!r}")
            for raw in numbers:
                low, high = f.raw_range
                if not low <= raw <= high:
                    raise ValueError(f"{self.name}.{f.name} must be in {low}..{high}, not {raw!r}")
                bits |= (raw & ((1 << f.format.width) - 1)) << offset
                offset += f.format.width
        return bits

    def unpack(self, bits: int) -> dict[str, int | list[int]]:
        """The raw values of one bit pattern, by field."""
        row: dict[str, int | list[int]] = {}
        for f in self.fields:
            values = []
            for _ in range(f.count):
                pattern = bits & ((1 << f.format.width) - 1)
                values.append(int(f.format.from_bits(pattern)) if isinstance(f.format, Fixed) else pattern)
                bits >>= f.format.width
            row[f.name] = values if f.count > 1 else values[0]
        return row


def uint(bits: int) -> Fixed:
    """A plain unsigned integer."""
    return UQ(bits, 0)


INDEX_BITS = 24
"""Bits of a Gaussian's index: models have up to 16 M Gaussians."""

COUNT_BITS = 24
"""Bits of the number of intersections of one tile."""

TILE_BITS = 10
"""Bits of a tile's column or row: enough for frames of 16,384 pixels on a side."""


def eye(config: AcceleratorConfig) -> tuple[Field, ...]:
    """Field of records of which a joint frame has one for each eye (`spec.joint`); nothing in machines without such frames."""
    return (Field("eye", uint(1), "the eye: 0 the source, or the only one; 1 the target"),) if config.joint else ()


def splat_eye(config: AcceleratorConfig) -> tuple[Field, ...]:
    """The same of splats in the second phase, of which a pair may have one for a single eye (`spec.joint_warp`)."""
    alone = (Field("alone", uint(1), "the pair has no splat for the other eye"),) if config.warps_joint else ()
    return eye(config) + alone


def gaussian_geometry(config: AcceleratorConfig) -> Record:
    """The first half of a Gaussian in memory, one 32-byte beat. It is read for every Gaussian."""
    n = config.formats
    return Record("GaussianGeometry", gaussian_geometry.__doc__, (
        Field("mean", n.position, "position in world units, relative to the model's origin", 3),
        Field("scale", n.scale, "standard deviations in world units", 3),
        Field("quat", n.quaternion, "normalised quaternion, wxyz", 4),
        Field("log2_opacity", n.log2_opacity, "log2 of the amplified opacity, per level", MAX_LEVELS),
        Field("bound", uint(2), "quality bound m - 1: the highest level that uses the Gaussian"),
    ))


def gaussian_colour(config: AcceleratorConfig, sh_degree: int = 3) -> Record:
    """The second half of a Gaussian in memory. It is read for Gaussians with an intersection only, and shorter for lower SH
    degrees."""
    n = config.formats
    count = 3 * ((sh_degree + 1) ** 2 - 1)
    rest = (Field("rest", n.sh_rest, "SH coefficients of degree 1 and more, r, g, b each, in 3DGS order", count),)
    return Record("GaussianColour", gaussian_colour.__doc__, (
        Field("dc", n.sh_dc, "base colour SH_C0 * dc + 0.5: r, g, b of level 1, then of the others", 3 * MAX_LEVELS),
        *(rest if sh_degree else ()),
    ))


def splat2d(config: AcceleratorConfig) -> Record:
    """A projected Gaussian with all of its colours, as the golden renderer dumps it (`--dump splats`).

    No hardware holds this record: the machine hands on ProjectedSplats, and the array reads SplatRecords.
    """
    n = config.formats
    return Record("Splat2D", splat2d.__doc__, (
        Field("index", uint(INDEX_BITS), "Gaussian index; breaks ties of depth"),
        Field("bound", uint(2), "quality bound m - 1"),
        Field("mean2d", n.mean2d, "projected mean in pixels: x, y", 2),
        Field("conic", n.conic, "Cholesky factors l1, l2, l3: u = l1 dx + l2 dy, v = l3 dy", 3),
        Field("log2_opacity", n.log2_opacity, "log2 of the amplified opacity, per level", MAX_LEVELS),
        Field("colour", n.colour, "colour: r, g, b of level 1, then of the others", 3 * MAX_LEVELS),
        Field("depth", n.depth, "z as a fraction of the frame's depth scale"),
        Field("depth_key", n.depth_key, "sort key"),
    ))


def tile_header(config: AcceleratorConfig) -> Record:
    """What the array must know of a tile before its intersections; one per tile, empty tiles too, in tile order."""
    n = config.formats
    return Record("TileHeader", tile_header.__doc__, (
        Field("tile_x", uint(TILE_BITS), "tile column"), Field("tile_y", uint(TILE_BITS), "tile row"),
        Field("outer", uint(1), "the tile's level is 2 or more, where alpha may reach 1"),
        Field("blend", uint(1), "the tile blends its level with the next"),
        Field("plane", n.plane, "blend parameter at the first pixel, its slope along x, along y", 3),
        Field("count", uint(COUNT_BITS), "number of intersections that follow"),
    ))


def array_splat(config: AcceleratorConfig) -> Record:
    """An intersection in rendering order, with the values of the tile's level and, in a blend tile, of the next level."""
    n = config.formats
    return Record("ArraySplat", array_splat.__doc__, (
        Field("mean2d", n.mean2d, "projected mean in pixels: x, y", 2),
        Field("conic", n.conic, "Cholesky factors l1, l2, l3: u = l1 dx + l2 dy, v = l3 dy", 3),
        Field("use", uint(1), "whether the Gaussian is used: at the tile's level, at the next", 2),
        Field("log2_opacity", n.log2_opacity, "log2 of the amplified opacity at the tile's level, at the next", 2),
        Field("colour", n.colour, "r, g, b at the tile's level, at the next", 6),
        Field("depth", n.depth, "z as a fraction of the frame's depth scale"),
    ))


def pixel_op(config: AcceleratorConfig) -> Record:
    """One splat at one level, as the setup unit hands it to the array. In machines with super-tiles the state of a tile's
    pixels is loaded and stored by ops of their own, which cover no pixel, for both banks at once."""
    n = config.formats
    start = (Field("first", uint(1), "first op of the tile in this bank: sums and transmittance start anew"),)
    drain = "last op of the tile in any bank: the tile's rows leave the array after it"
    place: tuple[Field, ...] = ()
    if config.supertiles:
        start = (Field("load", uint(1), "first op of a visit: every pixel takes its state"),)
        drain = "last op of a visit: the tile's rows leave the array after it, to the state memory unless `last` is set"
        place = (Field("place", uint((SUPER_TILES - 1).bit_length()), "number of the tile in its super-tile"),
                 *eye(config),
                 Field("fresh", uint(1), "of a load: the state starts anew; 0: it comes from the state memory"))
    return Record("PixelOp", pixel_op.__doc__, (
        Field("exponent", n.exponent, "exponent of alpha at the first pixel of the tile, with streams of its quarter, half an "
              "ulp of `cut` included"),
        Field("slope_x", n.slope, "first difference along x at the first pixel"),
        Field("slope_y", n.slope, "first difference along y at the first pixel"),
        Field("curve_xx", n.curvature, "second difference along x"), Field("curve_xy", n.curvature, "mixed second difference"),
        Field("curve_yy", n.curvature, "second difference along y"),
        Field("cut", n.cut, "exponent below which a pixel skips the splat"),
        Field("colour", n.colour, "r, g, b", 3), Field("depth", n.depth, "z as a fraction of the frame's depth scale"),
        Field("bank", uint(1), "level bank: 0 the tile's level, 1 the next"),
        Field("outer", uint(1), "alpha may reach 1"), *start,
        Field("last", uint(1), "the op is the background: weighted by the remaining transmittance, which it does not change"),
        Field("drain", uint(1), drain), *place,
    ))


def pixel_row(config: AcceleratorConfig) -> Record:
    """Finished pixels, levels blended: `array_x` neighbours of one row of a tile, left to right."""
    n, lanes = config.formats, config.array_x
    return Record("PixelRow", pixel_row.__doc__, (
        Field("tile_x", uint(TILE_BITS), "tile column"), Field("tile_y", uint(TILE_BITS), "tile row"),
        Field("row", uint(4), "row inside the tile"),
        Field("column", uint(4), "first column inside the tile, a multiple of the array's width"),
        Field("colour", n.accumulator, "r, g, b of each pixel, background included", 3 * lanes),
        Field("depth", n.depth_accumulator, "sum of weight * depth of each pixel, not yet divided by the coverage", lanes),
        Field("transmittance", n.transmittance, "what is left at the end of each pixel; coverage is 1 minus it", lanes),
        *eye(config),
    ))


def frame_tiles(config: AcceleratorConfig) -> int:
    """Largest number of tiles of a frame, whose height is at most `row_width`, too."""
    return (-(-config.row_width // TILE)) ** 2


def tile_index(config: AcceleratorConfig) -> Fixed:
    """The format of a tile's number in its frame, row-major."""
    return uint((frame_tiles(config) - 1).bit_length())


def frame_supertiles(config: AcceleratorConfig) -> int:
    """Largest number of super-tiles of a frame, whose height is at most `row_width`, too. A joint frame may have one column
    more."""
    tiles = -(-config.row_width // TILE)
    return (-(-tiles // SUPER_X) + config.joint) * -(-tiles // SUPER_Y)


def frame_lists(config: AcceleratorConfig) -> int:
    """Largest number of lists of a frame: one for each tile, or as many as a machine with super-tiles has."""
    return config.list_heads if config.supertiles else frame_tiles(config)


def list_index(config: AcceleratorConfig) -> Fixed:
    """The format of a list's number, which is that of its tile in machines without super-tiles; also that of a group's
    number, as there are no more groups than lists."""
    return uint((frame_lists(config) - 1).bit_length())


def intersection_tile(config: AcceleratorConfig) -> Record:
    """The tile of an intersection, as the tile merge unit counts it, or, with super-tiles, the list of a pair. An item with
    `end`, which is no intersection, follows the last one of a frame."""
    return Record("IntersectionTile", intersection_tile.__doc__, (
        Field("tile", list_index(config), "the intersection's tile, or the pair's list"),
        Field("end", uint(1), "all intersections of the frame have come; `tile` means nothing"),
    ))


def tile_group(config: AcceleratorConfig) -> Record:
    """A tile and the group it is merged into; one per tile, empty tiles too, in tile order. With super-tiles: a list."""
    return Record("TileGroup", tile_group.__doc__, (
        Field("tile", list_index(config), "native tile, or list"),
        Field("count", uint(COUNT_BITS), "number of its intersections, or pairs"),
        Field("group", list_index(config), "number of the group, consecutive from 0"),
        Field("last", uint(1), "last of its group"),
    ))


def list_group(config: AcceleratorConfig) -> Record:
    """A list and the group it is merged into, as TileGroup, in machines with super-tiles."""
    return Record("ListGroup", list_group.__doc__, (
        *tile_group(config).fields,
        Field("ends", uint(1), "last list of its super-tile"),
    ))


def intersection(config: AcceleratorConfig) -> Record:
    """An intersection as it is sorted. The sort order is that of the whole record, read as one unsigned number."""
    return Record("Intersection", intersection.__doc__, (
        Field("index", uint(INDEX_BITS), "Gaussian index"),
        Field("depth_key", config.formats.depth_key, "sort key"),
        Field("tile", list_index(config), "native tile, or the pair's list"),
    ))


def chunk_item(config: AcceleratorConfig) -> Record:
    """An intersection on its way through the sorter."""
    return Record("ChunkItem", chunk_item.__doc__, (
        *intersection(config).fields,
        Field("last", uint(1), "last item of its chunk"),
        Field("empty", uint(1), "the item is no intersection but the only, and so the last, item of an empty chunk"),
    ))


def intersection_item(config: AcceleratorConfig) -> Record:
    """An intersection as the tile test emits it. An item with `end`, which is no intersection, follows the last one of a
    frame."""
    return Record("IntersectionItem", intersection_item.__doc__, (
        *intersection(config).fields,
        Field("end", uint(1), "all intersections of the frame have come; the rest means nothing"),
    ))


def opacities_carried(config: AcceleratorConfig) -> int:
    """Opacities of a Gaussian that pass through projection: one per level, or with compact records the strongest alone, because
    the colour unit reads the others."""
    return 1 if config.compact else MAX_LEVELS


def _opacity(config: AcceleratorConfig) -> Field:
    """The opacities that pass through projection."""
    of = "that of the strongest level" if config.compact else "per level"
    return Field("log2_opacity", config.formats.log2_opacity, f"log2 of the amplified opacity, {of}", opacities_carried(config))


def gaussian_point(config: AcceleratorConfig) -> Record:
    """A Gaussian's geometry on its way into projection. A frame ends with an item with `end`, which is no Gaussian."""
    fields = gaussian_geometry(config).fields
    return Record("GaussianPoint", gaussian_point.__doc__, (
        *(_opacity(config) if f.name == "log2_opacity" else f for f in fields),
        Field("index", uint(INDEX_BITS), "Gaussian index"),
        Field("end", uint(1), "all Gaussians of the frame have come; the rest means nothing"),
    ))


def _projection(config: AcceleratorConfig) -> tuple[Field, ...]:
    """What projection finds of a splat, as later stages use it."""
    n = config.formats
    return (
        Field("index", uint(INDEX_BITS), "Gaussian index"), Field("bound", uint(2), "quality bound m - 1"),
        Field("mean2d", n.mean2d, "projected mean in pixels: x, y", 2),
        Field("conic", n.conic, "Cholesky factors l1, l2, l3: u = l1 dx + l2 dy, v = l3 dy", 3),
        _opacity(config),
        Field("depth", n.depth, "z as a fraction of the frame's depth scale"),
        Field("offset", n.view, "position minus the camera's, in world axes: the direction that the colour depends on", 3),
    )


def projected_splat(config: AcceleratorConfig) -> Record:
    """A splat that is not culled, and the box of tiles that it may touch. A frame ends with an item with `end`."""
    tile = uint(TILE_BITS)
    return Record("ProjectedSplat", projected_splat.__doc__, (
        *_projection(config),
        Field("depth_key", config.formats.depth_key, "sort key"),
        Field("first_x", tile, "first tile column of the box"), Field("last_x", tile, "last tile column"),
        Field("first_y", tile, "first tile row"), Field("last_y", tile, "last tile row"),
        *splat_eye(config),
        *([Field("none", uint(1), "the splat is culled in this eye; it has no tile")] if config.joint else []),
        *([Field("wanted", uint(SUPER_TILES), "tiles of the pair's super-tile that the sweep renders, one bit each")]
          if config.warps_joint else []),
        Field("end", uint(1), "all splats of the frame have come; the rest means nothing"),
    ))


def surviving_splat(config: AcceleratorConfig) -> Record:
    """A splat with at least one intersection, whose colour is to be computed. A frame ends with an item with `end`."""
    return Record("SurvivingSplat", surviving_splat.__doc__, (
        *_projection(config),
        Field("levels", uint(MAX_LEVELS), "levels of the tiles in which it has intersections, one bit per level"),
        *([Field("mask", uint(SUPER_TILES), "tiles of the super-tile in which it has intersections, one bit each; with "
                 "streams, those whose quarter it meets, for each stream", config.streams)] if config.supertiles else []),
        *splat_eye(config),
        Field("end", uint(1), "all splats of the frame have come; the rest means nothing"),
    ))


def tile_level(config: AcceleratorConfig) -> Record:
    """A tile's level, on its way into the tile test's table."""
    return Record("TileLevel", tile_level.__doc__, (
        Field("tile", tile_index(config), "native tile"),
        Field("level", uint(2), "level of the tile, 0..3"),
        Field("blend", uint(1), "the tile blends its level with the next"),
        *([Field("rendered", uint(1), "the tile is rendered; intersections of tiles that are not are dropped")]
          if config.stereo else []),
        *eye(config),
    ))


def tile_use(config: AcceleratorConfig) -> Record:
    """What the splat fetch unit must know of a tile before its intersections; one per tile, empty tiles too, in tile order."""
    return Record("TileUse", tile_use.__doc__, (
        Field("level", uint(2), "level of the tile, 0..3"),
        Field("blend", uint(1), "the tile blends its level with the next"),
        Field("count", uint(COUNT_BITS), "number of intersections that follow"),
    ))


RECORDS = (
    gaussian_geometry, gaussian_colour, splat2d, tile_header, array_splat, pixel_op, pixel_row, intersection_tile, tile_group,
    intersection, chunk_item, intersection_item, gaussian_point, projected_splat, surviving_splat, tile_level,
    tile_use)
