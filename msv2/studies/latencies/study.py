"""Measures the latencies of the machine's units in Amaranth's simulator, for reports/latencies.json (takes seconds).

    python -m msv2.studies latencies

A latency is measured in the paper's machine, from the cycle in which an item is transferred to the cycle in which the result is
offered. The unit holds nothing else, and memory answers a request in the next cycle. Where a unit waits for memory, `_request`
names the latency up to the request, and `_answer` that from the answer on. msv2/studies/results/units.py makes the
table of docs/units.md from them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from amaranth.hdl import Value
from amaranth.lib import stream, wiring
from amaranth.sim import Simulator

from msv2.studies.record import write_report
from rtl.axi.master import AxiMaster
from rtl.axi.read_port import ReadQueue
from rtl.axi.registers import RegisterFile
from rtl.chunks.chunk_reader import ChunkReader
from rtl.chunks.chunk_test import ChunkTest
from rtl.culling.colour import ColourUnit, splat_interval
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.tile_test import TileTest
from rtl.pixels.frame_packer import FramePacker
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.tile_lists.entry_writer import IntersectionWriter
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.vrc_array.pixel_writer import PixelWriter
from rtl.vrc_array.row import VrcRow
from spec import records
from spec.chunks import header_item
from spec.command_line import command_parser
from spec.config import PAPER, V3, AcceleratorConfig
from spec.constants import TILE
from spec.host_settings import limits
from spec.memory import WORDS
from spec.packed import BLOCK_HEIGHT
from spec.paths import REPORTS
from spec.registers import register_map

REPORT = REPORTS / "latencies.json"

SETTLING = 4
"""Number of cycles before the first item, in which settings take effect."""

LIMIT = 20_000
"""Number of cycles within which an item must have come through. Clearing after a reset takes one per tile of the largest
frame."""


@dataclass(frozen=True)
class Offer:
    """Items for an input.

    Attributes:
        valid, ready, payload: the signals of the input; `ready` may be a constant.
        words: the packed items; each is offered until it is taken.
        after: if given, one word becomes available after each cycle in which this signal was high.
    """

    valid: Value
    ready: Value
    payload: Value
    words: Sequence[int]
    after: Value | None = None


def to(port: stream.Interface, *words: int, after: stream.Interface | None = None) -> Offer:
    """Items for a stream. With `after`, each of them becomes available after a transfer of that stream."""
    return Offer(port.valid, port.ready, Value.cast(port.payload), words, None if after is None else after.valid & after.ready)


def word(record: records.Record, **values: object) -> int:
    """A packed item in which all fields but the named ones are zero."""
    row = np.zeros((), record.dtype)
    for name, value in values.items():
        row[name] = value
    return record.pack(row)


def latency(
    dut: wiring.Component, last: Offer, leaves: Value, *others: Offer, high: Sequence[Value] = (),
    settings: Mapping[str, int] | None = None, settling: int = SETTLING,
) -> int:
    """Cycles from the transfer of the last word of `last` to the first cycle in which `leaves` is high.

    Args:
        dut: the unit.
        last: the items whose last word starts the measurement.
        leaves: a signal that is high when the result is offered.
        others: items for further inputs, all of which are offered independently.
        high: inputs that are constantly 1.
        settings: values of inputs of `dut`, by name.
        settling: the number of cycles from the end of reset to the first offers.

    Raises:
        ValueError: nothing leaves within LIMIT cycles.
    """
    offers, found = [last, *others], []

    async def bench(ctx) -> None:
        for name, value in (settings or {}).items():
            ctx.set(getattr(dut, name), value)
        for signal in high:
            ctx.set(signal, 1)
        await ctx.tick().repeat(settling)
        sent, asked, begin = [0] * len(offers), [0] * len(offers), None
        for cycle in range(LIMIT):
            for place, offer in enumerate(offers):
                offered = sent[place] < min(len(offer.words), len(offer.words) if offer.after is None else asked[place])
                ctx.set(offer.valid, offered)
                if offered:
                    ctx.set(offer.payload, offer.words[sent[place]])
            await ctx.delay(1e-10)
            for place, offer in enumerate(offers):
                asked[place] += offer.after is not None and ctx.get(offer.after)
                sent[place] += ctx.get(offer.valid) & ctx.get(offer.ready)
            if begin is None and sent[0] == len(last.words):
                begin = cycle
            if begin is not None and ctx.get(leaves):
                found.append(cycle - begin)
                return
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    if not found:
        raise ValueError(f"{type(dut).__name__} must give something within {LIMIT} cycles, not nothing")
    return found[0]


def projection(config: AcceleratorConfig) -> dict[str, int]:
    """The end item of a frame, which passes every operator."""
    dut = ProjectionUnit(config)
    return {"projection": latency(
        dut, to(dut.sink, word(records.gaussian_point(config), end=1)), dut.source.valid, high=[dut.source.ready])}


def tile_test(config: AcceleratorConfig) -> dict[str, int]:
    """A splat in the middle of a frame of one tile."""
    dut, n = TileTest(config), config.formats
    splat = word(
        records.projected_splat(config), mean2d=n.mean2d.quantise(np.full(2, TILE / 2)),
        conic=n.conic.quantise(np.array([0.25, 0.0, 0.25])))
    return {"tile_test": latency(
        dut, to(dut.splats, splat), dut.entries.valid, to(dut.table, 0), high=[dut.entries.ready, dut.survivors.ready],
        settings={"width": TILE, "height": TILE})}


def colour_unit(config: AcceleratorConfig) -> dict[str, int]:
    """A splat of SH degree 3 and one level: the least and the largest latency, as the datapath accepts a splat only in one
    cycle of its interval."""
    found = []
    for phase in range(splat_interval(config)):
        dut = ColourUnit(config)
        splat = to(dut.survivors, word(records.surviving_splat(config), levels=1))
        found.append(latency(
            dut, splat, dut.writes.valid, to(dut.data, 0, 0, 0, after=dut.reads), high=[dut.reads.ready, dut.writes.ready],
            settings={"sh_degree": 3}, settling=SETTLING + phase))
    return {"colour_unit": min(found), "colour_unit_most": max(found)}


def chunk_units(config: AcceleratorConfig) -> dict[str, int]:
    """Of the same machine with chunks and compact records: the end of a frame through the chunk test, and a chunk of one
    Gaussian through the reader."""
    config = config.with_(order=V3.order, chunks=V3.chunks, records=V3.records)
    chunk, end = (word(header_item(config), **{name: 1}) for name in ("count", "end"))
    test, ask, answer = ChunkTest(config), ChunkReader(config), ChunkReader(config)
    return {
        "chunk_test": latency(test, to(test.headers, end), test.tested.valid, high=[test.tested.ready]),
        "chunk_reader_request": latency(ask, to(ask.tested, chunk), ask.reads.valid, high=[ask.points.ready]),
        "chunk_reader_answer": latency(
            answer, to(answer.data, 0, after=answer.reads), answer.points.valid, to(answer.tested, chunk),
            high=[answer.reads.ready, answer.points.ready])}


def entry_writer(config: AcceleratorConfig) -> dict[str, int]:
    """The first intersection of a tile, up to its write."""
    dut = IntersectionWriter(config)
    return {"entry_writer": latency(
        dut, to(dut.entries, 0), dut.writes.valid, high=[dut.hits.ready, dut.writes.ready, dut.writes_idle],
        settings={"entries_beats": 1 << 16, "tile_count": 1})}


def tile_merge_unit(config: AcceleratorConfig) -> dict[str, int]:
    """The end of a frame, up to the first group."""
    dut = TileMergeUnit(config)
    return {"tile_merge_unit": latency(
        dut, to(dut.hits, word(records.intersection_tile(config), end=1)), dut.groups.valid, high=[dut.groups.ready],
        settings={"tiles_x": 1, "tile_count": 1})}


def of_tiles(unit: type[ListReader] | type[HeaderMaker], config: AcceleratorConfig, begin: str, end: str) -> int:
    """The latency from port to port of a unit that reads memory for tiles, in a frame of one tile with one intersection."""
    dut = unit(config)
    tile = word(records.tile_group(config), count=1, last=1)
    offers = {"tiles": to(dut.tiles, tile), "data": to(dut.data, 0, after=dut.reads)}
    taken = [getattr(dut, name).ready for name in ("reads", "groups", "headers", "levels") if hasattr(dut, name)]
    settings = {name: 1 for name in ("tiles_x", "tile_count") if hasattr(dut, name)}
    return latency(dut, offers.pop(begin), getattr(dut, end).valid, *offers.values(), high=taken, settings=settings)


def readers(config: AcceleratorConfig) -> dict[str, int]:
    """The list reader and the header maker."""
    return {
        "list_reader_request": of_tiles(ListReader, config, "tiles", "reads"),
        "list_reader_answer": of_tiles(ListReader, config, "data", "groups"),
        "header_maker_request": of_tiles(HeaderMaker, config, "tiles", "reads"),
        "header_maker_answer": of_tiles(HeaderMaker, config, "data", "headers")}


def handover(config: AcceleratorConfig) -> dict[str, int]:
    """Through the line buffer, a group's first intersection; through the double buffer, from a group's last intersection to the
    output of its first."""
    entry, found = records.chunk_item(config), {}
    for name, dut, words in (("line_buffer", LineBuffer(config), [0]),
                             ("double_buffer", DoubleBuffer(config), [0, 0, word(entry, last=1)])):
        found[name] = latency(dut, to(dut.sink, *words), dut.source.valid, high=[dut.source.ready])
    return found


def row(config: AcceleratorConfig) -> dict[str, int]:
    """An operation, up to the next row of cores."""
    dut = VrcRow(config)
    op = Offer(dut.op_in.valid, Value.cast(1), dut.op_in.colour[0], [1])
    return {"vrc_row": latency(dut, op, dut.op_out.valid)}


def pixel_writer(config: AcceleratorConfig) -> dict[str, int]:
    """A row of pixels, up to its first beat."""
    dut = PixelWriter(config)
    return {"pixel_writer": latency(
        dut, to(dut.rows, 0), dut.writes.valid, high=[dut.writes.ready, dut.writes_idle],
        settings={"width": TILE, "height": TILE, "tile_count": 1})}


def frame_packer(config: AcceleratorConfig) -> dict[str, int]:
    """The last row of a block, up to the block's first beat."""
    dut = FramePacker(config)
    rows = [word(records.pixel_row(config), row=row) for row in range(BLOCK_HEIGHT)]
    return {"frame_packer": latency(
        dut, to(dut.rows, *rows), dut.writes.valid, high=[dut.writes.ready, dut.writes_idle],
        settings={"width": TILE, "height": TILE, "tile_count": 1})}


def axi_master(config: AcceleratorConfig) -> dict[str, int]:
    """A request up to the bus, an answer from the bus, and an answer through a client's queue."""
    ask = AxiMaster(config, 1, 1)
    answer, queue = AxiMaster(config, 1, 1), ReadQueue(config, 4)
    beat = Offer(answer.m_axi_rvalid, answer.m_axi_rready, answer.m_axi_rdata, [1], answer.m_axi_arvalid & answer.m_axi_arready)
    return {
        "axi_master_request": latency(ask, to(ask.reads[0], 0), ask.m_axi_arvalid, high=[ask.m_axi_arready]),
        "axi_master_answer": latency(
            answer, beat, answer.beats[0].valid, to(answer.reads[0], 0), high=[answer.m_axi_arready, answer.beats[0].ready]),
        "read_queue": latency(
            queue, to(queue.beats, (1 << 32 * WORDS) - 1, after=queue.requests), queue.data.valid, to(queue.reads, 0),
            high=[queue.requests.ready, queue.data.ready])}


def register_file(config: AcceleratorConfig) -> dict[str, int]:
    """A write to `control.start` on the bus, up to `start`. Legal settings are written before."""
    dut, at = RegisterFile(config), {register.name: register.offset for register in register_map(config)}
    writes = [*((at[limit.setting], limit.low) for limit in limits(config)), (at["control"], 1)]
    addresses = Offer(dut.s_axi_awvalid, dut.s_axi_awready, dut.s_axi_awaddr, [address for address, _ in writes])
    data = Offer(dut.s_axi_wvalid, dut.s_axi_wready, dut.s_axi_wdata, [value for _, value in writes])
    return {"register_file": latency(dut, data, dut.start, addresses, high=[dut.s_axi_bready], settings={"s_axi_wstrb": 15})}


MEASURES: tuple[Callable[[AcceleratorConfig], dict[str, int]], ...] = (
    chunk_units, projection, tile_test, colour_unit, entry_writer, tile_merge_unit, readers, handover, row, pixel_writer,
    frame_packer, axi_master, register_file)
"""The functions that measure units; each returns latencies by name."""


def main(argv: Sequence[str] | None = None) -> int:
    """Measures all units, prints the latencies and writes the report."""
    command_parser("msv2 study run latencies", __doc__).parse_args(argv)
    cycles = {name: value for measure in MEASURES for name, value in measure(PAPER).items()}
    print(cycles)
    write_report(REPORT, {"config": PAPER.name, "cycles": cycles}, [__name__], {"config": PAPER})
    return 0
