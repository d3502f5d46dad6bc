"""The work that is played on each netlist, and the operations that are counted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from golden.msv2_ref.frame_memory import frame_pixels
from golden.msv2_ref.pipeline import Frame
from msv2.studies.energy_per_operation.gates import Window
from msv2.studies.energy_per_operation.setup_ops import setup_ops
from spec.config import AcceleratorConfig
from spec.records import array_splat, chunk_item, frame_lists, pixel_op, tile_header
from tb.common.exact import Planned, planned
from tb.common.playback import Playback, Stream
from tb.culling import colour_device, colour_suite
from tb.culling import colour_stimuli as colour
from tb.culling import projection_stimuli as culling
from tb.culling import projection_suite as culling_suite
from tb.culling import tile_test_stimuli as tiles
from tb.culling import tile_test_suite as tiles_suite
from tb.sort_tmu import handover_suite, hierarchical_suite
from tb.sort_tmu import tile_merge_stimuli as tmu
from tb.sort_tmu import tile_merge_suite as tmu_suite
from tb.sort_tmu.chunk_stimuli import whole_groups
from tb.vrc_array import fetch_device, fetch_suite
from tb.vrc_array import fetch_stimuli as fetch
from tb.vrc_array import pixel_writer_device as writer_device
from tb.vrc_array.array_check import run_of
from tb.vrc_array.array_device import background_bits, rows_per_tile, vrc_playback
from tb.vrc_array.pixel_writer_stimuli import rows_of, writes_of
from tb.vrc_array.traced import case_of, pick_tiles

DELAY = 60
"""Latency of the memory in cycles, for units that read."""


@dataclass(frozen=True)
class Work:
    """A run on the netlist of a unit.

    Attributes:
        unit: its name in `rtl.units`.
        operation: the operation that is counted, in the singular.
        count: the number of operations in the window, from what moved in it.
        playback, plan: the test bench and the run.
        window: the cycles of the run that are counted.
        answers, counters: see `gates.play`.
        constants: values of ports that are neither streams nor settings.
        strobe: a port that is high for one cycle before the run.
    """

    unit: str
    operation: str
    count: Callable[[Mapping[str, int]], int]
    playback: Playback
    plan: Planned
    window: Window
    answers: Mapping[str, str] = field(default_factory=dict)
    counters: tuple[str, ...] = ()
    constants: Mapping[str, int] = field(default_factory=dict)
    strobe: str | None = None


def moved(port: str, each: int = 1) -> Callable[[Mapping[str, int]], int]:
    """Counts `each` operations for each item that a stream has moved."""
    return lambda moved: each * moved[port]


def projection(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Points pass near test and projection."""
    case = culling.shortened(culling.traced_case(frame, name), 2000)
    return Work("projection_unit", "point", moved("sink"), culling_suite.playback(config), culling_suite.plan_of(case),
                Window(200, 400))


def tile_test(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Splats are tested against tiles."""
    plan = tiles_suite.plan_of(tiles.case_of(frame, name))
    return Work("tile_test", "entry", moved("entries"), tiles_suite.playback(config), plan,
                Window(200 + len(plan.run.inputs["table"]), 500))


def colours(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Survivors get their colours."""
    plan = colour_suite.plan_of(config, colour.frame_case(name, frame), delay=DELAY)
    return Work("colour_unit", "splat", moved("survivors"), colour_device.playback(config), plan, Window(400, 800),
                answers={"data": "reads"})


def tile_merge(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Intersections are counted and tiles grouped. The window begins after the unit has cleared its counters."""
    plan = tmu_suite.plan_of(config, tmu.case_of(frame, name, None))
    return Work("tile_merge_unit", "entry", moved("hits"), tmu_suite.playback(config), plan,
                Window(frame_lists(config) + 200, 500, whole=True))


def sorter(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Groups that fit the sort buffer are sorted. The memory for larger groups is not accessed."""
    groups = [group for group in whole_groups(frame) if len(group) <= config.sort_chunk]
    plan = hierarchical_suite.plan_of(config, name, groups)
    playback = replace(  # without the test bench's memory
        hierarchical_suite.playback(config), inputs=(Stream("groups", chunk_item(config)),),
        outputs=(Stream("sorted", chunk_item(config)),))
    return Work("hierarchical_sorter", "entry", moved("sorted"), playback, plan, Window(8000, 600),
                constants={"reads__ready": 1, "writes__ready": 1, "writes_idle": 1})


def line_buffer(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Sorted intersections pass the line buffer."""
    items = hierarchical_suite.plan_of(config, name, whole_groups(frame)).expected["sorted"]
    return Work("line_buffer", "entry", moved("source"), handover_suite.playback(config),
                handover_suite.plan_of(config, name, items), Window(100, 500))


def splat_fetch(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Intersections get their splat records, from a cache that is empty at first."""
    plan = fetch_suite.Plan(config, 0)
    plan.add(fetch.traced_case(name, frame), delay=DELAY)
    return Work("splat_fetch", "entry", moved("entries"), fetch_device.playback(config), plan.runs[0], Window(1000, 500),
                answers={"data": "reads"})


def setup(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """The intersections of some tiles become operations; no tile stops early."""
    case = pick_tiles(case_of(frame, name), 0, 6, 500)
    background = background_bits(config, case.background)
    plan = planned(name, {"tiles": case.headers, "entries": case.entries},
                   {"ops": setup_ops(config, case.headers, case.entries, background)}, settings={"background": background})
    playback = Playback("setup", "setup", "", (Stream("tiles", tile_header(config)), Stream("entries", array_splat(config))),
                        (Stream("ops", pixel_op(config)),), (("background", 3 * config.formats.colour.width),))
    return Work("setup", "op", moved("ops"), playback, plan, Window(50, 200, whole=True))


def array(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Tiles pass the array, up to their last pixel."""
    case = pick_tiles(case_of(frame, name), 0, 3, 500)
    run = run_of(config, case)
    return Work("vrc_array", "op", moved("ops"), vrc_playback(config), Planned(run, {}), Window(120, 160, whole=True),
                counters=("ops", "skipped"))


def writer(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """The array's rows become display pixels in memory."""
    pixels, r = frame_pixels(frame), frame.registers
    rows = rows_of(config, pixels, np.random.default_rng(0))
    plan = planned(
        name, {"rows": rows}, {"writes": writes_of(config, pixels, rows, 0, True)},
        settings={"width": r.width, "height": r.height, "display": 1, "frame_base": 0,
                  "tile_count": len(rows) // rows_per_tile(config)})
    return Work("pixel_writer", "pixel", moved("rows", config.cores_x), writer_device.playback(config), plan, Window(50, 300),
                constants={"writes_idle": 1}, strobe="begin")


WORK: dict[str, Callable[[AcceleratorConfig, str, Frame], Work]] = {
    "projection_unit": projection, "tile_test": tile_test, "colour_unit": colours, "tile_merge_unit": tile_merge,
    "hierarchical_sorter": sorter, "line_buffer": line_buffer, "splat_fetch": splat_fetch, "setup": setup, "vrc_array": array,
    "pixel_writer": writer}
"""The measured work, by unit."""
