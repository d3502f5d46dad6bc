"""Every field of the configuration changes what it should: cycles, pixels, area, energy. A field without an entry fails."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import render_stereo
from golden.scenes.request import Request, parse_request, resolve
from golden.scenes.stereo import stereo_pair
from msv2.studies.area.estimate import estimate_area
from msv2.studies.energy.frame import frame_energy, load_table, model_counts
from msv2.studies.energy.supertiles import super_counts, super_table
from perf.model import MemoryModel, simulate
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import super_trace
from perf.trace import trace_of
from spec.config import PAPER, AcceleratorConfig, NumberFormats
from spec.overrides import changed, convert

SMALL_SORTER = {"sort_buffer_bytes": 256}
"""A sorter of 16 intersections, which spills nearly every group of the frame."""


@dataclass(frozen=True)
class Effect:
    """What changes with a field.

    Attributes:
        to: the field's other value, as on a command line.
        does: what must change: "pixels", "depths" or "second eye"; "cycles", "area", "energy", "bytes" of memory or "tests" of
            runs of tiles, with + or - for more or less; "name".
        beside: other values of the same change, which the relations between formats demand.
        base: what both machines have in common, where PAPER would not show the effect.
    """

    to: str
    does: str
    beside: tuple[str, ...] = ()
    base: tuple[tuple[str, object], ...] = ()


STEREO = (("stereo", True),)
SPATIAL = (("order", "spatial"),)
CHUNKS = (*SPATIAL, ("chunks", True))
COMPACT = (*CHUNKS, ("records", "compact"))
V3 = (*COMPACT, ("lists", "supertile"))
EFFECTS = {
    "name": Effect("other", "name"),
    "cores_x": Effect("8", "cycles+ area-"),
    "cores_y": Effect("8", "cycles+ area-"),
    "levels": Effect("1", "area-"),
    "sh_degree": Effect("1", "pixels area- energy- bytes-"),
    "blend": Effect("false", "area-"),
    "depth": Effect("false", "area-"),
    "fine_depth": Effect("true", "depths area+"),
    "support_sigma": Effect("2", "pixels cycles-"),
    "culling_units": Effect("4", "cycles+ area-"),
    "row_width": Effect("960", "area- energy-"),
    "line_buffer_bytes": Effect("64", "cycles+ area-", base=tuple(SMALL_SORTER.items())),
    "sort_buffer_bytes": Effect("1024", "cycles+ area- bytes+"),
    "incremental": Effect("false", "cycles+ area+ energy+"),
    "lockstep": Effect("true", "cycles+", base=(("incremental", False),)),
    "merge_ways": Effect("2", "cycles+ area- bytes+", base=tuple(SMALL_SORTER.items())),
    "splat_cache_lines": Effect("64", "cycles+ area- bytes+"),
    "counters": Effect("false", "area-"),
    "stereo": Effect("true", "area+"),
    "warp_lanes": Effect("1", "cycles+ area-", base=STEREO),
    "warp_columns": Effect("64", "area- energy-", base=STEREO),
    "warp_fill": Effect("interior", "second eye", base=STEREO),
    "warp_veiled": Effect("true", "second eye", base=STEREO),
    "order": Effect("spatial", "bytes-"),
    "chunks": Effect("true", "cycles- area+ bytes-", base=SPATIAL),
    "records": Effect("compact", "pixels cycles- bytes-", base=CHUNKS),
    "lists": Effect("supertile", "cycles- bytes-", base=COMPACT),
    "list_heads": Effect("2048", "area+", base=V3),
    "buckets": Effect("false", "area-", base=V3),
    "header_lines": Effect("16", "area- bytes+", base=V3),
    "batch_places": Effect("64", "cycles+ area-", base=V3),
    "streams": Effect("4", "cycles- area+", base=V3),
    "packed": Effect("true", "area+ bytes-", base=V3),
    "joint": Effect("true", "area+", base=V3),
    "overlap": Effect("true", "area+", base=V3),
    "read_beats": Effect("4", "cycles+ area-"),
    "bank_memories": Effect("true", "area-", base=(("cores_x", 2), ("cores_y", 2))),
    "formats.chunk": Effect("float5e8b127", "bytes+", base=CHUNKS),
    "formats.position": Effect("float19e8b127", "pixels"),
    "formats.scale": Effect("ufloat11e6b40", "pixels"),
    "formats.quaternion": Effect("SQ0.12", "pixels"),
    "formats.log2_opacity": Effect("SQ4.9", "pixels", ("formats.cut=SQ3.9",)),
    "formats.sh_dc": Effect("SQ2.10", "pixels"),
    "formats.sh_rest": Effect("SQ1.9", "pixels area-"),
    "formats.sh_basis": Effect("SQ0.12", "pixels area-"),
    "formats.view": Effect("float19e8b127", "pixels area-", ("formats.position=float19e8b127",)),
    "formats.work": Effect("float16e8b127", "pixels area-"),
    "formats.extent": Effect("ufloat12e5b8", "tests+"),
    "formats.mean2d": Effect("SQ14.9", "pixels area-"),
    "formats.conic": Effect("float15e6b63", "pixels area-", ("formats.factor=SQ1.14",)),
    "formats.colour": Effect("UQ1.8", "pixels area-"),
    "formats.depth": Effect("UQ0.13", "depths area-"),
    "formats.depth_key": Effect("UQ21.0", "area- energy-"),
    "formats.offset": Effect("SQ5.15", "pixels"),
    "formats.factor": Effect("SQ1.14", "pixels", ("formats.conic=float15e6b63",)),
    "formats.exponent": Effect("SQ11.13", "pixels area-", ("formats.slope=SQ7.13", "formats.curvature=SQ3.13")),
    "formats.slope": Effect("SQ8.14", "area+"),
    "formats.curvature": Effect("SQ4.14", "area+"),
    "formats.cut": Effect("SQ3.9", "pixels", ("formats.log2_opacity=SQ4.9",)),
    "formats.alpha": Effect("UQ1.11", "pixels area-"),
    "formats.transmittance": Effect("UQ0.14", "pixels area-"),
    "formats.weight": Effect("UQ0.11", "pixels area-"),
    "formats.accumulator": Effect("UQ1.13", "pixels area-"),
    "formats.depth_accumulator": Effect("UQ0.17", "depths area-"),
    "formats.plane": Effect("SQ6.11", "pixels"),
    "formats.blend_weight": Effect("UQ1.7", "pixels"),
    "formats.exp2_segments": Effect("8", "pixels area-"),
}


@dataclass(frozen=True)
class Seen:
    """What one machine makes of the frame."""

    pixels: np.ndarray
    depths: np.ndarray
    second: np.ndarray | None
    cycles: int
    area: float
    energy: float
    bytes: int
    tests: int


@cache
def request(stereo: bool) -> Request:
    """A frame with harmonics, four levels and blending tiles; a larger one for two eyes, so that pixels are warped."""
    size, gaze = ("128x64", "20,20") if stereo else ("96x64", "30,20")
    return resolve(parse_request("embedded", "--size", size, "--gaze", gaze, "--levels", "4"))


@cache
def seen(config: AcceleratorConfig) -> Seen:
    asked = request(config.stereo)
    second = None
    if config.stereo:
        frame = render_stereo(asked.model, stereo_pair(asked.camera, units_per_metre=1.0), config=config,
                              foveation=asked.foveation, threshold_deg=2.0)
        source, second = frame.source, np.stack([frame.target_pixels["colour"]])
    else:
        levels = min(asked.foveation.levels, config.levels)
        frame = source = pipeline.render(asked.model, asked.camera, config=config,
                                         foveation=asked.foveation if levels > 1 else None)
    memory, table = MemoryModel("ideal"), load_table()  # LPDDR3 alone would bound small frames
    if config.supertiles:
        trace = super_trace(frame)
        cycles = simulate_supertiles(trace, config, memory=memory, display=True, packed=config.packed)
        counts, table, tests = super_counts(trace, cycles, config), super_table(table, config), trace.pairs
    else:
        trace = trace_of(frame)
        cycles = simulate(trace, config, memory=memory, display=True)
        counts, tests = model_counts(trace, cycles), sum(len(eye.run_entries) for eye in trace.eyes)
    energy = frame_energy(counts, cycles.total, config, table)
    area = estimate_area(config).mm2
    return Seen(source.pixels.colour, source.pixels.depth, second, cycles.total, area, energy.chip_mj,
                sum((*cycles.reads.values(), *cycles.writes.values())), tests)


def test_every_field_has_an_entry():
    known = {f.name for f in fields(AcceleratorConfig)} - {"formats"} | {f"formats.{f.name}" for f in fields(NumberFormats)}
    assert set(EFFECTS) == known


@pytest.mark.parametrize("name", EFFECTS)
def test_a_field_changes_what_it_should(name):
    effect = EFFECTS[name]
    base = PAPER.with_(**dict(effect.base))
    values = {name: effect.to} | dict(text.split("=") for text in effect.beside)
    other = changed(base, {field: convert(field, value) for field, value in values.items()})
    if name == "name":
        assert other.name.startswith("other") and other.with_(name=base.name) == base
        return
    before, after = seen(base), seen(other)
    for word in effect.does.replace("second eye", "second_eye").split():
        if word == "pixels":
            assert np.any(before.pixels != after.pixels)
        elif word == "depths":
            assert np.any(before.depths != after.depths)
        elif word == "second_eye":
            assert np.any(before.second != after.second)
        else:
            was, now = getattr(before, word[:-1]), getattr(after, word[:-1])
            assert (now > was) if word[-1] == "+" else (now < was), f"{word[:-1]} of {was} became {now}"
