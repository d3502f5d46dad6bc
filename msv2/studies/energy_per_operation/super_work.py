"""The work that is played on netlists of units that only machines with lists by super-tile have (`spec.supertiles`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.frame_memory import frame_pixels
from golden.msv2_ref.pipeline import Frame
from msv2.studies.energy_per_operation.gates import Window
from msv2.studies.energy_per_operation.work import DELAY, Work, moved
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, frame_settings, read_data, read_request, write_request
from spec.records import chunk_item, gaussian_point, pixel_row, projected_splat, surviving_splat, tile_level
from spec.supertiles import batch_place, supertile, supertile_pair, tile_visit, visit_entry
from tb.common.exact import Planned, planned
from tb.common.playback import Playback, Stream
from tb.common.player import Run
from tb.culling.tile_test_stimuli import case_of
from tb.pixels.packer_stimuli import packed_pixels, packed_writes, tile_order
from tb.supertiles import colour_stimuli, colour_suite, record_fetch_stimuli, record_fetch_suite
from tb.supertiles.batch_stimuli import Case, wanted_visits
from tb.supertiles.tile_test_stimuli import SuperCase, numbered
from tb.vrc_array.pixel_writer_stimuli import rows_of


def supertile_test(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Splats are tested against super-tiles, as in the first phase."""
    case = SuperCase(numbered(case_of(frame, name)), again=False)
    inputs = case.inputs | {"splats": case.inputs["splats"][:-1]}  # one item ends the phase; the bench alone takes another one
    plan = planned(name, inputs, case.expected, settings=case.base.settings)
    widths = {f.name: f.width for f in frame_settings(config).fields}
    playback = Playback(
        "supertile_test", "supertile_test", "",
        (Stream("splats", projected_splat(config)), Stream("table", tile_level(config))),
        (Stream("pairs", supertile_pair(config)), Stream("survivors", surviving_splat(config))),
        tuple((port, widths[port]) for port in ("width", "height", "obb")))
    return Work("supertile_test", "pair", moved("pairs"), playback, plan, Window(200 + len(plan.run.inputs["table"]), 500))


def record_fetch(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Records of sorted pairs are read by way of their chunks' headers, none of which is in the machine at first."""
    model, _ = record_fetch_stimuli.stored_model(config, frame.words)
    item = record_fetch_suite.Plan(config, 0).add(
        record_fetch_stimuli.Case("", model, frame.pairs.index.astype(np.int64)), name, delay=DELAY,
        sh_degree=frame.words.sh_degree)
    beats, request = read_data(config), read_request(config)
    playback = Playback(
        "record_fetch", "record_fetch", "",
        (Stream("sorted", chunk_item(config)), Stream("data_chunks", beats), Stream("data_colour", beats)),
        (Stream("points", gaussian_point(config)), Stream("beats", beats), Stream("reads_chunks", request),
         Stream("reads_colour", request)),
        (("chunks_base", BEAT_BITS), ("colour_base", BEAT_BITS), ("sh_degree", 2)))
    run = replace(item.run, settings=item.run.settings | {"delay": DELAY})
    return Work("record_fetch", "pair", moved("points"), playback, replace(item, run=run), Window(1000, 500),
                answers={"data_chunks": "reads_chunks", "data_colour": "reads_colour"})


def colours(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Pairs get their colours, one for each of their levels."""
    plan = colour_suite.plan_of(config, colour_stimuli.frame_case(name, frame))
    return Work("pair_colour", "pair", moved("survivors"), colour_suite.playback(config, config.sh_degree), plan,
                Window(400, 800))


def batches(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Places fill batches, which are dealt to tiles of which none stops."""
    golden = FrameBatches(frame)
    inputs = {"supertiles": golden.supertile_records, "places": golden.place_records}
    expected = {"visits": golden.visit_records, "entries": golden.entry_records}
    run = Run(name, inputs, {port: len(rows) for port, rows in expected.items()}, {})
    playback = Playback(
        "batch_buffer", "batch_buffer", "",
        (Stream("supertiles", supertile(config)), Stream("places", batch_place(config))),
        (Stream("visits", tile_visit(config)), Stream("entries", visit_entry(config))))
    return Work("batch_buffer", "entry", moved("entries"), playback, Planned(run, expected), Window(1500, 600))


def streams(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """Places fill batches, which are dealt to the quarters of tiles of which none stops."""
    golden, expected = FrameBatches(frame), {}
    case = Case(name, golden.supertile_records, golden.place_records)
    for q in range(config.streams):
        visits = wanted_visits(config, case, 0, q)
        expected[f"visits__{q}"] = np.array([visit.row for visit in visits])
        expected[f"entries__{q}"] = np.concatenate([visit.entries for visit in visits])
    run = Run(name, {"supertiles": case.supertiles, "places": case.places}, {p: len(rows) for p, rows in expected.items()}, {})
    playback = Playback(
        "stream_buffer", "stream_buffer", "",
        (Stream("supertiles", supertile(config)), Stream("places", batch_place(config))),
        tuple(Stream(port, tile_visit(config) if port.startswith("visits") else visit_entry(config)) for port in expected))
    return Work("stream_buffer", "entry", lambda moved: sum(n for port, n in moved.items() if port.startswith("entries")),
                playback, Planned(run, expected), Window(1500, 600))


def packer(config: AcceleratorConfig, name: str, frame: Frame) -> Work:
    """The array's rows become a packed frame in memory."""
    pixels, r = frame_pixels(frame), frame.registers
    rows, columns = rows_of(config, pixels, np.random.default_rng(0)), -(-r.width // TILE)
    order = tile_order(rows, columns)
    plan = planned(
        name, {"rows": rows}, {"writes": packed_writes(config, packed_pixels(config, pixels), order, 0)},
        settings={"width": r.width, "height": r.height, "frame_base": 0, "tile_count": len(order)})
    playback = Playback("frame_packer", "frame_packer", "", (Stream("rows", pixel_row(config)),),
                        (Stream("writes", write_request(config)),),
                        tuple((port, BEAT_BITS) for port in ("width", "height", "frame_base", "tile_count")))
    return Work("frame_packer", "pixel", moved("rows", config.cores_x), playback, plan, Window(100, 400),
                constants={"writes_idle": 1}, strobe="begin")


SUPER_WORK: dict[str, Callable[[AcceleratorConfig, str, Frame], Work]] = {
    "supertile_test": supertile_test, "record_fetch": record_fetch, "pair_colour": colours, "batch_buffer": batches,
    "stream_buffer": streams, "frame_packer": packer}
"""The measured work, by unit."""
