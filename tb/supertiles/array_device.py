"""The array of machines with super-tiles with files at its streams."""

from __future__ import annotations

from functools import cache

from spec.config import AcceleratorConfig
from spec.queues import COUNTER_BITS
from spec.records import pixel_row
from spec.supertiles import SEQUENCE_BITS, batch_tiles, tile_visit, visit_entry
from tb.common.emission import emitted
from tb.common.playback import Playback, Stream


@cache
def batch_array_playback(config: AcceleratorConfig) -> Playback:
    """The array of a configuration, emitted as Verilog, with a file at each stream."""
    return Playback(
        name=f"batch-array-{config.cores_x}x{config.cores_y}{'-joint' * config.joint}", module="batch_array",
        verilog=emitted("batch_array", config),
        inputs=(Stream("visits", tile_visit(config)), Stream("entries", visit_entry(config))),
        outputs=(Stream("pixels", pixel_row(config)),),
        settings=(("background", 3 * config.formats.colour.width), *((("quarter", 2),) if config.streams > 1 else ())),
        observed=(*((name, COUNTER_BITS) for name in ("ops", "skipped", "waits")), ("busy", 1), ("current", SEQUENCE_BITS),
                  ("done", batch_tiles(config))),
        apart=("batch_core",))
