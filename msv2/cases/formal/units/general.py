"""Units of which the general claims are proven: what holds of any unit with streams (`contract.general`).

The machines are small, so that memories are few words deep; numbers have the widths that they have in every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from amaranth.hdl import Mux
from amaranth.lib import wiring

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.contract import general, holds, once, silent
from msv2.cases.formal.proof import SMALL, SMALL_SUPER, Proof
from rtl.chunks.chunk_reader import ChunkReader
from rtl.chunks.geometry_decode import GeometryDecode
from rtl.chunks.header_reader import ChunkHeaderReader
from rtl.culling.colour import ColourUnit
from rtl.culling.eyes import EyeCulls, EyePoints
from rtl.culling.near import NearTest
from rtl.culling.tile_expand import TileExpand
from rtl.culling.tile_runs import TileRuns
from rtl.pixels.block_differences import BlockDifferences
from rtl.pixels.block_packer import BlockPacker
from rtl.pixels.block_rows import BlockRows
from rtl.pixels.block_unpacker import BlockUnpacker
from rtl.pixels.frame_reader import FrameReader
from rtl.supertiles.batch_buffer import BatchBuffer
from rtl.supertiles.batch_visits import BatchVisits
from rtl.supertiles.box_steps import BoxSteps
from rtl.supertiles.bucket_search import BucketSearch
from rtl.supertiles.buckets import SingleLists
from rtl.supertiles.clip import SuperTileClip
from rtl.supertiles.colour import PairColour
from rtl.supertiles.depth_buckets import DepthBuckets
from rtl.supertiles.group_walk import GroupWalk
from rtl.supertiles.mask_expand import MaskExpand
from rtl.supertiles.pair_expand import PairExpand
from rtl.supertiles.pair_union import PairUnion
from rtl.supertiles.pair_writer import PairWriter
from rtl.supertiles.reader import SuperTileReader
from rtl.supertiles.row_join import RowJoin
from rtl.tile_lists.beats import BeatRun
from rtl.tile_lists.entry_writer import IntersectionWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.page_walk import ListedTiles, PageWalk
from rtl.tile_lists.table_loader import TableLoader
from rtl.tile_lists.tile_settings import TileSettings
from rtl.vrc_array.batch_collect import BatchCollect
from rtl.vrc_array.batch_setup import BatchSetup
from rtl.vrc_array.collect import Collect
from rtl.vrc_array.pixel_writer import PixelWriter
from rtl.vrc_array.setup import SetupUnit
from rtl.vrc_array.splat_fetch import SplatFetch
from rtl.vrc_array.splat_tags import SplatTags
from rtl.warp_unit.fill import Fill
from rtl.warp_unit.pack import Pack
from rtl.warp_unit.window import Window
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS

STEREO = SMALL.with_(stereo=True, warp_lanes=1)
EYES = SMALL_SUPER.with_(joint=True)
STREAMS = SMALL_SUPER.with_(streams=4, cores_x=8, cores_y=8)


def drains(bench: Bench) -> None:
    """A drain is issued when it may, and when its tile's place is there."""
    bench.assume(~bench.unit.draining | bench.unit.may_drain & bench.unit.places.valid)
    if hasattr(bench.unit, "storing"):
        bench.assume(~bench.unit.storing | bench.unit.may_store & bench.unit.draining)


def masks(bench: Bench) -> None:
    """A word that was read stays until the next one, and a tile that has stopped stays so while its super-tile is current."""
    unit = bench.unit
    bench.assume(bench.before(unit.read_en) | (unit.read_data == bench.before(unit.read_data)))
    done = bench.before(unit.done)
    bench.assume((unit.current != bench.before(unit.current)) | ((unit.done & done) == done))


def batch(bench: Bench) -> None:
    """A place, any one, of one tile becomes one entry, in a visit of its tile; no tile has stopped."""
    unit, place, entry = bench.unit, bench.unit.places.payload, bench.unit.entries.payload
    places, entries, visits = bench.sinks["places"], bench.sources["entries"], bench.sources["visits"]
    tile = bench.some(range(len(place.mask)), "tile")
    marked = places.moves & place.depth[0]
    bench.assume(~places.port.valid | ~place.depth[0] | (place.mask == 1 << tile))
    following = bench.register("following", 2)  # places of a pair before its last one
    bench.assume(~places.port.valid | place.last | (following != MAX_LEVELS - 1))
    with bench.m.If(places.moves):
        bench.m.d.sync += following.eq(Mux(place.last, 0, following + 1))
    leaves = entries.moves & ~entry.end & entry.depth[0]
    once(bench, "a place of one tile", marked, leaves, empty=~unit.busy)
    ahead = bench.count(visits.moves, entries.moves & entry.end, 3)
    bench.never("a visit ends once, and after it has begun", ahead < 0, when=bench.before(entries.moves & entry.end))


def _of(unit: Callable[..., wiring.Component], config: AcceleratorConfig = SMALL, *claims: Callable[[Bench], object],
        seconds: float = 8.0, at: str = "", options: Mapping[str, Any] | None = None, busily: bool = True,
        **world: Any) -> Proof:
    """The general claims of a unit of a machine; not `busily` where `busy` does not speak of items inside."""
    first = (general,) if busily else (holds, silent)
    return Proof(unit, lambda: unit(config, **(options or {})), (*first, *claims), at, world, seconds)


PROOFS = (
    _of(ChunkReader, SMALL_SUPER, busily=False),  # it is busy from `start` to `end`, whatever is sent before
    _of(GeometryDecode, SMALL_SUPER),
    _of(ChunkHeaderReader, SMALL, at="in the model's order"),
    _of(ChunkHeaderReader, SMALL_SUPER, at="by super-tiles"),
    _of(BeatRun, SMALL, options={"count_bits": 8}),
    _of(GeometryReader),
    _of(TableLoader),
    _of(TileSettings, free=("last",)),
    _of(IntersectionWriter, busily=False),  # it is busy until the next frame may begin, and `end` may leave later
    _of(ListReader),
    _of(ListedTiles),
    _of(PageWalk),
    _of(HeaderMaker),
    _of(NearTest),
    _of(EyePoints, EYES),
    _of(EyeCulls, EYES, free=("rendering",)),
    _of(TileRuns, free=("codes", "row_start")),
    _of(TileExpand),
    _of(ColourUnit),
    _of(PairColour, SMALL_SUPER),
    _of(SplatFetch, options={"pending": 8}, at="8 splats on their way"),
    _of(SplatTags),
    _of(SuperTileClip, SMALL_SUPER, free=("rendering",)),
    _of(BoxSteps, SMALL_SUPER, free=("rendering",)),
    _of(GroupWalk, SMALL_SUPER, free=("levels",)),
    _of(PairExpand, SMALL_SUPER, busily=False),  # it is busy with what it does not offer yet
    _of(MaskExpand, SMALL_SUPER),
    _of(PairUnion, EYES),
    _of(DepthBuckets, SMALL_SUPER, busily=False, free=("sorted_item", "sorted_taken")),  # busy with bounds, not with items
    _of(SingleLists, SMALL_SUPER, busily=False),  # it stores nothing
    _of(BucketSearch, SMALL_SUPER),
    _of(PairWriter, SMALL_SUPER, busily=False),  # as IntersectionWriter
    _of(SuperTileReader, SMALL_SUPER),
    _of(BatchBuffer, SMALL_SUPER, free=("done", "current")),
    _of(BatchBuffer, SMALL_SUPER, batch, at="tiles of one level that do not stop", seconds=4, held={"done": 0},
        narrow={"supertiles": {"level": 0}, "places": {"level": 0}}),
    _of(BatchVisits, SMALL_SUPER, masks, loose=("items",), free=("done", "current", "waiting", "waiting_half", "read_data")),
    _of(RowJoin, STREAMS),
    _of(SetupUnit, SMALL, free=("stopped",)),
    _of(BatchSetup, SMALL_SUPER, free=("stopped",)),
    _of(Collect, SMALL, drains, free=("draining",)),
    _of(BatchCollect, SMALL_SUPER, drains, free=("draining", "storing", "place")),
    _of(PixelWriter),
    _of(BlockRows),
    _of(BlockDifferences),
    _of(BlockPacker),
    _of(FrameReader),
    _of(BlockUnpacker),
    _of(Fill, STEREO),
    _of(Pack, STEREO),
    _of(Window, STEREO, free=("start", "run", "rows", "last", "kept_valid", "kept")),
)
