"""Super-tiles: lists of Gaussians for 8 by 2 tiles at a time, from which records are gathered and projected again.

Machines with `lists = "supertile"` store no splat record. The words used here: a *super-tile* is a block of SUPER_X by SUPER_Y
tiles; a *pair* is a splat and a super-tile with at least one tile that the splat has an intersection with; a *list* holds
pairs of one super-tile whose depth keys lie between two bounds; a *batch* is a part of a super-tile's pairs, in rendering
order; a *place* is the splat record of one pair at one level, in the batch buffer; a *visit* is the stay of one tile in the
array.

**First phase.** Gaussians pass the chunk test, projection and the tile test as in other machines, but the intersections of a
splat become one pair for every super-tile that has any of them. Super-tiles are numbered row by row; the pairs of a splat come
in the order of these numbers. What is counted of Gaussians, splats and intersections is counted in this phase alone.

**Order of chunks.** The first phase reads chunks in CHUNK_STREAMS streams by turns, CHUNK_RUN chunks of each: the model's
chunks are cut into as many parts of CHUNK_RUN ceil(chunks / (CHUNK_RUN CHUNK_STREAMS)), of which the last ones may be shorter
or empty, and the first runs of all parts are followed by the second ones, and so on. So a long part of the model that the chunk
test skips, or whose splats have many pairs, keeps a unit busy for a share of the time only, and runs are long enough for the
pages of DRAM. The order changes no pixel, because pairs are sorted by depth key and index.

**Index.** The `index` of a pair, and of every record on its way here, is chunk << PLACE_BITS | place in the chunk. It orders
Gaussians as their position in memory does. The header of the chunk, at chunks_base + chunk, has the position of its first one.

**Lists.** A pair lies in memory as an Intersection does, 8 bytes, with the number of its list in the field `tile`, in pages as
`spec.memory` describes them, with lists instead of tiles. Its beats are written whole: up to BEAT_ENTRIES - 1 pairs of each
list wait in the machine, and are written when the phase ends. A partly filled beat is written whole, too; its rest means
nothing.

**Depth buckets.** Super-tile s has bounds B[0] <= B[1] <= ..., and so one list more than bounds. A pair with the depth key k
belongs to list first[s] + (the number of bounds of s that are <= k), where first[s] = s + the number of bounds of all
super-tiles before s. Bounds come from the frame before: while a super-tile's pairs leave the sorter, the keys of pairs number
BUCKET_PAIRS, 2 BUCKET_PAIRS, ... (the first pair has number 0) become its bounds, until it has BUCKETS - 1 of them or all
super-tiles together have as many bounds as there are lists beyond one for each super-tile (`frame_lists` - the frame's number
of super-tiles). There are no bounds after a reset, after a frame that failed, or where the frame before had another number of
super-tiles; the first frame makes some. Bounds change the order of nothing: lists of a super-tile follow each other, so pairs
still come by depth key and index.

**Second phase.** The lists are merged into groups and sorted as in other machines; only the last list ends a row for the tile
merge unit. For every sorted pair the machine reads the chunk's header through a cache of HEADER_WAYS ways, and the Gaussian's
CompactColour (and CompactHarmonics, where the frame has harmonics); decodes its geometry, which gives the words of its
CompactGeometry; projects it again; clips its box of tiles to the super-tile; and tests the tiles again. This gives a mask of
those tiles of the super-tile that the splat has an intersection with; bit SUPER_X * (row in the super-tile) + column. Then the
colour unit makes a BatchPlace for every level among these tiles, lowest level first.

**Batches.** A super-tile's places fill the batch buffer in this order. A batch ends with a pair after which fewer than
MAX_LEVELS places are free, or with the super-tile's last pair. A super-tile without pairs has one empty batch. For each batch
the tiles of the super-tile that lie in the frame are visited in the order of their numbers:

- in a batch that is not the super-tile's last: each tile with a place in the batch, unless all of its pixels have stopped;
- in the last one: every tile, and its background and rows follow.

A visit begins with the load of the tile's state, or with a fresh state where the tile has not been visited before, and ends
with its store, or with the tile's background and its rows. It takes the tile's places in order, but ends early once all pixels
of the tile have stopped. A state is loaded only after the last row of its store is in the memory.

**Streams.** With four streams (`config.streams`) the cores form four arrays of `array_x` by `array_y` cores, and array q
renders a quarter of every tile, its *region*: `region` by `region` pixels, in column q % 2 and row q / 2 of the tile. An array
has its own setup unit, its own state memory for the regions of a super-tile, and its own stream of visits and entries:

- The batch buffer is filled once for all streams. Its half is free again when all streams have done with it; until then one
  stream may be a batch ahead of another.
- What is said of tiles in *Batches* and of visits holds for regions: a stream visits the regions of the tiles with a place in
  the stream's mask, unless all of the region's pixels have stopped, and in the last batch those of all tiles. So all streams
  visit the same tiles last, in the same order.
- Quarters. A pair has a bit for tile and stream where it has an intersection with the tile, the columns of pixels that the
  tile test found in the tile's 16 rows reach into the region, and the ellipse's extent along y, rounded to `mean2d`, reaches
  within TILE_EDGE_MARGIN of the centre of the region's first or last row inside the frame, or beyond it. (With bounding boxes
  instead of the exact test, where it has an intersection.) The test leaves out no pixel that an op could change, and a pair
  may have a place with no bit at all.
- The exponent is computed for the tile's centre as with one stream, and only then moved to the region's first pixel, which is
  exact. So pixels do not depend on the number of streams.
- Rows of pixels go to memory as one array would give them, the array of `frame_rows`: where the regions of two arrays fill a
  row of a tile, their rows are joined; otherwise the arrays take turns, block by block.
- `ops`, `skipped` and visits are sums over all streams. Batches are counted once.
"""

from __future__ import annotations

from spec.chunks import PLACE_BITS
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, TILE
from spec.memory import splat_record, tile_setting
from spec.records import (
    COUNT_BITS,
    INDEX_BITS,
    TILE_BITS,
    Field,
    Record,
    array_splat,
    eye,
    frame_lists,
    frame_supertiles,
    tile_header,
    uint,
)

CHUNK_BITS = INDEX_BITS - PLACE_BITS
"""Bits of a chunk's number."""

CHUNK_STREAMS = 8
"""Parts of the model whose chunks are read by turns, a power of two."""

CHUNK_RUN = 4
"""Chunks that are read of a part in its turn, a power of two."""

BUCKET_PAIRS = 1536
"""Pairs between two bounds."""

BUCKETS = 32
"""Most lists of a super-tile."""

HEADER_WAYS = 4
"""Ways of the cache of chunk headers. The low bits of a chunk's number choose its set, of which the line that was loaded first
is replaced."""

SUPER_PLACES = (SUPER_TILES - 1).bit_length()
"""Bits of a tile's number in its super-tile."""

SEQUENCE_BITS = 3
"""Bits by which the array tells super-tiles apart that follow each other."""


def supertile_index(config: AcceleratorConfig) -> int:
    """Bits of a super-tile's number."""
    return (frame_supertiles(config) - 1).bit_length()


def supertile_pair(config: AcceleratorConfig) -> Record:
    """A pair as the tile test of the first phase emits it. An item with `end`, which is no pair, follows the last one of a
    frame."""
    return Record("SuperTilePair", supertile_pair.__doc__, (
        Field("index", uint(INDEX_BITS), "chunk and place of the Gaussian"),
        Field("depth_key", config.formats.depth_key, "sort key"),
        Field("supertile", uint(supertile_index(config)), "super-tile"),
        *eye(config),
        Field("end", uint(1), "all pairs of the frame have come; the rest means nothing"),
    ))


def supertile(config: AcceleratorConfig) -> Record:
    """A super-tile before its pairs; one per super-tile, empty ones too, in order. In a joint frame two per super-tile, first
    with the tiles of the source, then with those of the target; columns are those of the joint super-tiles, and so O[eye] more
    than those of the eye's frame (`spec.joint`)."""
    setting = {f.name: f for f in tile_setting(config).fields}
    return Record("SuperTile", supertile.__doc__, (
        Field("x", uint(TILE_BITS), "column of its first tile, a multiple of SUPER_X"),
        Field("y", uint(TILE_BITS), "row of its first tile, a multiple of SUPER_Y"),
        Field("pairs", uint(COUNT_BITS), "number of pairs that follow, those of all of its lists"),
        Field("inside", uint(SUPER_TILES), "tiles that lie in the frame, one bit each"),
        Field("level", uint(2), "level of each tile, 0..3", SUPER_TILES),
        Field("blend", uint(SUPER_TILES), "tiles that blend their level with the next, one bit each"),
        Field("plane", setting["plane"].format, "of each tile: blend parameter at the first pixel, its slopes along x and y",
              3 * SUPER_TILES),
        *eye(config),
    ))


def batch_place(config: AcceleratorConfig) -> Record:
    """A splat record for the batch buffer: that of one pair at one level."""
    return Record("BatchPlace", batch_place.__doc__, (
        *splat_record(config).fields,
        Field("level", uint(2), "the level, 0..3"),
        Field("mask", uint(SUPER_TILES), "tiles of the super-tile, of any level, with an intersection, one bit each; with "
              "streams, those whose quarter it meets, for each stream", config.streams),
        *eye(config),
        *([Field("none", uint(1), "no place: the pair has no tile that the sweep renders")] if config.warps_joint else []),
        Field("last", uint(1), "last place of its pair, of both eyes"),
    ))


def tile_visit(config: AcceleratorConfig) -> Record:
    """A visit of a tile, before its entries."""
    header = tuple(f for f in tile_header(config).fields if f.name != "count")
    return Record("TileVisit", tile_visit.__doc__, (
        *header,
        Field("place", uint(SUPER_PLACES), "number of the tile in its super-tile"),
        Field("sequence", uint(SEQUENCE_BITS), "number of the super-tile since the last reset, its lowest bits"),
        Field("fresh", uint(1), "the tile's first visit: its state starts anew; 0: it is loaded"),
        Field("final", uint(1), "the tile's last visit: background and rows follow; 0: its state is stored"),
        *eye(config),
    ))


def visit_entry(config: AcceleratorConfig) -> Record:
    """An intersection of the visited tile in rendering order. An item with `end`, which is none, follows a visit's last one."""
    return Record("VisitEntry", visit_entry.__doc__, (
        *array_splat(config).fields,
        Field("end", uint(1), "all intersections of the visit have come; the rest means nothing"),
    ))


def frame_rows(config: AcceleratorConfig) -> AcceleratorConfig:
    """The machine as the writer of its frame sees it: with one array, whose rows are those that its streams give together."""
    if config.streams == 1:
        return config
    return config.with_(streams=1, cores_x=TILE if 2 * config.array_x == TILE else config.array_x, cores_y=config.array_y)


def batch_tiles(config: AcceleratorConfig) -> int:
    """Tiles to which a batch is dealt, and of which the array has a state: those of a super-tile and, in machines with joint
    frames, behind those of the source the target's. A tile's number among them is its `place`, with its `eye` above."""
    return SUPER_TILES << config.joint


def batch_tile_bits(config: AcceleratorConfig) -> int:
    """Bits of a tile's number among those of `batch_tiles`."""
    return (batch_tiles(config) - 1).bit_length()


def check_supertiles(config: AcceleratorConfig) -> None:
    """Raises ValueError where the config has no super-tiles, or its sizes do not suit each other."""
    if not config.supertiles:
        raise ValueError(f"lists must be 'supertile' for this unit, not {config.lists!r}")
    if frame_supertiles(config) > frame_lists(config):
        raise ValueError(f"list_heads must be at least {frame_supertiles(config)} for rows of {config.row_width} pixels, "
                         f"not {config.list_heads!r}")


SUPERTILE_RECORDS = (supertile_pair, supertile, batch_place, tile_visit, visit_entry)
