"""The table of the RTL's units in docs/units.md: source, golden renderer, tests, latency, throughput and area of each."""

from __future__ import annotations

from msv2.studies import page
from rtl.culling.colour import splat_interval
from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.vrc_array import blend, expand, row, setup, splat_fetch
from spec.chunks import TEST_INTERVAL
from spec.config import PAPER, PAPER_SMALL

Reports = dict[str, dict]

UNITS = (
    ("geometry reader, table loader", "tile_lists/geometry_reader, table_loader", "pipeline", "sim TEST=lists",
     "memory's, 1 beat/cycle", ""),
    ("level bounds, chunk test (with `chunks`)", "chunks/level_bounds, chunk_test", "chunk_test", "sim TEST=chunk_test",
     "{chunk_test} cycles, 1 chunk/{chunk_interval} cycles", "chunk_test"),
    ("header reader, chunk reader (with `chunks`)", "chunks/header_reader, chunk_reader, geometry_decode", "../host/compact",
     "sim TEST=chunk_reader", "{chunk_reader_request} + {chunk_reader_answer} cycles, 1 point/cycle",
     "chunk_header_reader, chunk_reader"),
    ("near test, projection", "culling/projection_unit", "projection", "sim TEST=culling", "{projection} cycles, 1 point/cycle",
     "near_test, projection"),
    ("tile test, foveation filter", "culling/tile_test", "tile_test", "sim TEST=culling",
     "{tile_test} cycles, 1 run and 1 intersection/cycle", "tile_test"),
    ("colour unit", "culling/colour", "colour", "sim TEST=culling",
     "{colour_unit} to {colour_unit_most} cycles, 1 SH-3 splat/{interval} cycles", "colour_unit"),
    ("entry writer", "tile_lists/entry_writer", "tile_lists", "sim TEST=lists", "{entry_writer} cycles, 1 intersection/cycle",
     "entry_writer"),
    ("tile merge unit", "sort_tmu/tile_merge", "tile_merge", "sim TEST=tmu",
     "{tile_merge_unit} cycles, 1 intersection, 1 tile/cycle", "tile_merge_unit"),
    ("list reader, header maker", "tile_lists/list_reader, header_maker", "tile_lists", "sim TEST=lists",
     "{list_reader_request} + {list_reader_answer}, {header_maker_request} + {header_maker_answer} cycles and memory's, "
     "1 intersection, 1 tile/cycle", "list_reader"),
    ("chunk sorter", "sort_tmu/chunk_sorter", "sort", "sim TEST=sort", "the chunk, 1 intersection/cycle", "chunk_sorter"),
    ("sorter of groups of any size", "sort_tmu/hierarchical_sorter", "sort", "sim TEST=sort",
     "the group, 1 intersection/cycle", ""),
    ("line buffer, double buffer", "sort_tmu/handover", "-", "sim TEST=sort",
     "{line_buffer}, the group and {double_buffer} cycles, 1 intersection/cycle", ""),
    ("splat fetch", "vrc_array/splat_fetch", "fetch", "sim TEST=vrc", "{splat_fetch} cycles, 1 intersection/cycle",
     "splat_fetch"),
    ("setup unit", "vrc_array/setup, polynomial", "array_kernel", "test_setup", "{setup} cycles, 1 op/cycle", "setup"),
    ("expansion", "vrc_array/expand", "array_kernel", "test_expand", "{expand} cycles, 1 op/cycle", "expand"),
    ("pixel core", "vrc_array/pixel_core", "array_kernel", "test_pixel_core", "{pixel_core} cycles, 1 op/cycle",
     "pixel_core"),
    ("row of 16 cores", "vrc_array/row", "array_kernel", "test_array", "{vrc_row} cycle to the next row", "vrc_row"),
    ("level blending", "vrc_array/blend", "array_kernel", "test_blend", "{blend} cycles, 1 row/cycle", "blend"),
    ("whole array", "vrc_array/array", "array", "sim TEST=vrc", "1 intersection/cycle", ""),
    ("box clip, super-tile test (with super-tiles)", "supertiles/clip, tile_test", "supertiles", "sim TEST=supertile_test",
     "1 super-row, 1 pair/cycle", "supertile_clip, supertile_test"),
    ("depth buckets, pair writer (with super-tiles)", "supertiles/depth_buckets, pair_writer", "supertiles, buckets",
     "sim TEST=pair_lists", "1 pair/cycle", "depth_buckets, pair_writer"),
    ("super-tile reader, record fetch (with super-tiles)", "supertiles/reader, record_fetch", "supertiles",
     "sim TEST=record_fetch", "memory's, 1 list, 1 pair/cycle; 1 pair/2 cycles with harmonics",
     "supertile_reader, record_fetch"),
    ("colour unit of pairs (with super-tiles)", "supertiles/colour", "colour", "sim TEST=pair_colour",
     "1 SH-3 pair/2 cycles", "pair_colour"),
    ("batch buffer (with super-tiles)", "supertiles/batch_buffer", "batches", "sim TEST=batch",
     "1 place, 1 entry/cycle, together", "batch_buffer"),
    ("batch buffer, arrays and rows of four streams (with `streams`)", "supertiles/stream_buffer, stream_arrays, row_join",
     "batches, regions", "sim TEST=batch", "1 place, 1 entry/cycle for each stream, 1 row of 16 pixels/cycle",
     "stream_buffer, row_join"),
    ("pixel writer", "vrc_array/pixel_writer", "frame_memory", "sim TEST=vrc", "{pixel_writer} cycles, 1 beat/cycle",
     "pixel_writer"),
    ("frame packer (with `packed`)", "pixels/frame_packer, block_packer", "frame_packing", "sim TEST=frame_packer",
     "{frame_packer} cycles, 1 row, 1 beat/cycle", "frame_packer"),
    ("warp unit (with `stereo`)", "warp_unit/", "warp", "sim TEST=warp", "a ring of columns, 4 pixels/cycle", "warp_unit"),
    ("AXI master, read queues", "axi/master, read_port", "-", "sim TEST=axi",
     "{axi_master_request} + {axi_master_answer}, {read_queue} cycles, a read and a write/cycle", "axi_master"),
    ("registers, counters", "axi/registers, counters", "-", "sim TEST=axi", "{register_file} cycles to start", "register_file"),
    ("frame controller, machine", "top/controller, machine", "pipeline", "sim TEST=top, frame", "see frames", ""),
    ("float add, multiply", "float/add, multiply", "../host/rounding", "sim TEST=float",
     "{float_add}, {float_mul} cycles, 1/cycle", "float_add, float_mul"),
    ("float divide, 1/x", "float/divide", "../host/rounding", "sim TEST=float",
     "{float_divide}, {float_reciprocal} cycles, 1/cycle", "float_divide, float_reciprocal"),
    ("float 1/sqrt, sqrt", "float/roots", "../host/rounding", "sim TEST=float",
     "{float_rsqrt}, {float_sqrt} cycles, 1/cycle", "float_rsqrt, float_sqrt"),
    ("float from, to fixed", "float/convert", "../host/rounding", "sim TEST=float",
     "{fixed_to_float}, {float_to_fixed} cycles, 1/cycle", "fixed_to_float, float_to_fixed"),
)
"""For each unit: title, source, golden module, tests, latency and throughput, and names of synthesised units.

The braces in latency and throughput stand for numbers of `unit_cycles`.
"""


class _Cycles(dict):
    """Numbers by name. A number that was not measured is shown as a question mark."""

    def __missing__(self, name: str) -> str:
        return "?"


def unit_cycles(reports: Reports) -> dict[str, int]:
    """Latencies by name. Some are constants of the RTL, which its tests verify; the others were measured for
    reports/latencies.json. `interval` is that of the colour unit."""
    stated = {
        "interval": splat_interval(PAPER), "chunk_interval": TEST_INTERVAL,
        "splat_fetch": splat_fetch.LATENCY, "setup": setup.LATENCY,
        "expand": expand.latency(PAPER_SMALL), "pixel_core": row.PIPELINE + row.SUMS_LATER, "blend": blend.BLEND_LATENCY,
        "float_add": FloatAdd.latency, "float_mul": FloatMul.latency, "float_divide": FloatDivide.latency,
        "float_reciprocal": FloatReciprocal.latency, "float_rsqrt": FloatRsqrt.latency, "float_sqrt": FloatSqrt.latency,
        "fixed_to_float": FixedToFloat.latency, "float_to_fixed": FloatToFixed.latency}
    return _Cycles(stated | reports.get("latencies", {"cycles": {}})["cycles"])


def units_table(reports: Reports) -> str:
    """The source, golden module, tests, latency, throughput and area of every RTL unit. Rates are those of PAPER's machine."""
    synthesis, cycles = {r["unit"]: r for r in reports.get("synthesis", {"rows": []})["rows"]}, unit_cycles(reports)
    rows = [[*unit[:4], unit[4].format_map(cycles), _areas(synthesis, unit[5])] for unit in UNITS]
    header = ["unit", "rtl/", "golden/msv2_ref/", "make, or tests/rtl/vrc_array/", "latency, throughput",
              "logic in ASAP7 (slack at 1 ns)"]
    return page.table(header, rows)


def _areas(synthesis: dict[str, dict], names: str) -> str:
    """The areas and slacks of those of the named units that were synthesised, and the size of their memories."""
    found = [synthesis[name] for name in names.split(", ") if name in synthesis]
    bits = sum(r.get("memory_bits", 0) for r in found)
    memories = f" and {bits / 8192:,.1f} KB" if bits else ""
    return ", ".join(f"{r['area_um2']:,.0f} um² ({r['slack_ps']:+.0f} ps)" for r in found) + memories if found else "-"
