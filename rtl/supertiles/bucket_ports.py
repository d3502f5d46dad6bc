"""The ports of the units that give pairs their lists."""

from __future__ import annotations

from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.beats import check_config
from spec.config import AcceleratorConfig
from spec.records import chunk_item, frame_lists, frame_supertiles, intersection_item, list_group, tile_group
from spec.supertiles import check_supertiles, supertile_pair


def bucket_ports(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    """The ports of a unit that gives pairs their lists.

    pairs: SuperTilePair items of a frame, then one with `end`.
    entries: an IntersectionItem for each of them, in the same order; `tile` is the list.
    groups: TileGroup items of every list, in order.
    listed: a ListGroup for each of them, in the same order.
    sorted_item, sorted_taken: the ChunkItem that leaves the sorter, and whether it does in this cycle. The unit only looks on.
    supertile_count: number of the frame's super-tiles, 1 or more; stable from `clear` until the frame ends.
    list_count: number of the frame's lists; stable from the second cycle after `clear` until the next one.
    clear: strobe: a frame begins. The bounds that the frame before made are those of this one.
    forget: strobe: bounds that have been made for the next frame are void, and none are made until the next `clear`. Where both
        come together, the frame begins without bounds.
    busy: bounds have been seen that are not stored yet: `clear` must not come without `forget`.

    Raises:
        TypeError: `config` is no AcceleratorConfig.
        ValueError: it has no super-tiles.
    """
    check_config(config)
    check_supertiles(config)
    return {
        "pairs": In(stream.Signature(layout(supertile_pair(config)))),
        "entries": Out(stream.Signature(layout(intersection_item(config)))),
        "groups": In(stream.Signature(layout(tile_group(config)))),
        "listed": Out(stream.Signature(layout(list_group(config)))),
        "sorted_item": In(layout(chunk_item(config))), "sorted_taken": In(1),
        "supertile_count": In(range(frame_supertiles(config) + 1)), "list_count": Out(range(frame_lists(config) + 1)),
        "clear": In(1), "forget": In(1), "busy": Out(1),
    }
