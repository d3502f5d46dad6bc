"""AcceleratorConfig: what it refuses, and what the named configurations promise."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, replace

import pytest

from spec.config import (
    BALANCED,
    CONFIGS,
    DEFAULT,
    FAST,
    FPGA,
    HEADSET,
    MACHINES,
    PAPER,
    PAPER_SMALL,
    PRECISE,
    PRESETS,
    SHORT_FORMATS,
    TINY,
    TINY_EYES,
    TINY_EYES_OVERLAP,
    TINY_EYES_WARP,
    TINY_OVERLAP,
    TINY_STREAMS,
    TINY_V3,
    V3,
    V3_EYES,
    V3_EYES_LARGE,
    V3_EYES_OVERLAP,
    V3_EYES_STREAMS,
    V3_EYES_WARP,
    V3_OVERLAP,
    V3_PACKED,
    V3_RECORDS,
    V3_STREAMS,
    V3_STREAMS_PACKED,
    AcceleratorConfig,
    NumberFormats,
)
from spec.queues import READ_DEPTHS, SUPERTILE_READ_DEPTHS, read_depths

RANGES = {
    "cores_x": (2, 16), "cores_y": (2, 16), "levels": (1, 4), "sh_degree": (0, 3), "culling_units": (1, 8),
    "row_width": (16, 8192), "line_buffer_bytes": (64, 1 << 20), "sort_buffer_bytes": (256, 1 << 24),
    "merge_ways": (2, 32), "splat_cache_lines": (4, 1 << 16), "warp_lanes": (1, 16),
    "warp_columns": (64, 8192), "list_heads": (2, 1 << 14), "header_lines": (4, 1 << 14), "batch_places": (16, 4096),
    "read_beats": (4, 512),
}
FLAGS = ("blend", "depth", "fine_depth", "incremental", "counters", "stereo", "warp_veiled", "chunks", "buckets",
         "lockstep", "packed", "joint", "overlap", "bank_memories")
POWERS_OF_TWO = ("culling_units", "sort_buffer_bytes", "merge_ways", "splat_cache_lines", "warp_lanes", "warp_columns",
                 "header_lines", "batch_places", "read_beats")


@pytest.mark.parametrize("name", RANGES)
def test_integers_are_held_to_their_range(name):
    low, high = RANGES[name]
    for good in (low, high):
        assert getattr(DEFAULT.with_(**{name: good}), name) == good
    for bad in (low - 1, high + 1, -5):
        with pytest.raises(ValueError, match=rf"^{name} must be .*not {bad}$"):
            DEFAULT.with_(**{name: bad})
    for bad in (4.0, "4", None, True, [4]):
        with pytest.raises(TypeError) as caught:
            DEFAULT.with_(**{name: bad})
        assert str(caught.value).startswith(name) and str(caught.value).endswith(f"not {bad!r}")


@pytest.mark.parametrize("name", ["cores_x", "cores_y"])
def test_arrays_divide_the_tile(name):
    for cores in range(2, 17):
        if 16 % cores == 0:
            assert DEFAULT.with_(**{name: cores}).blocks == 16 // cores
        else:
            with pytest.raises(ValueError, match=rf"^{name} must divide 16, not {cores}$"):
                DEFAULT.with_(**{name: cores})


@pytest.mark.parametrize("name", POWERS_OF_TWO)
def test_powers_of_two(name):
    low, high = RANGES[name]
    bad = min(max(12, low * 3 // 2), high - 2)
    with pytest.raises(ValueError, match=rf"^{name} must be a power of two, not {bad}$"):
        DEFAULT.with_(**{name: bad})


@pytest.mark.parametrize("name", FLAGS)
def test_flags_are_bools(name):
    with pytest.raises(TypeError, match=rf"^{name} must be a bool, not 1$"):
        DEFAULT.with_(**{name: 1})


@pytest.mark.parametrize(("name", "bad", "error"), [
    ("formats", None, TypeError), ("formats", {}, TypeError),
    ("support_sigma", 0, ValueError), ("support_sigma", 8.1, ValueError), ("support_sigma", float("nan"), ValueError),
    ("support_sigma", float("inf"), ValueError), ("support_sigma", "3", TypeError), ("support_sigma", True, TypeError),
    ("name", "", ValueError), ("name", "a/b", ValueError), ("name", None, TypeError), ("name", 3, TypeError),
    ("warp_fill", "all", ValueError), ("warp_fill", None, ValueError), ("warp_fill", [], ValueError),
    ("order", "random", ValueError), ("order", None, ValueError), ("records", "narrow", ValueError), ("records", 2, ValueError),
    ("lists", "supertiles", ValueError), ("lists", None, ValueError),
])
def test_other_parameters_are_checked(name, bad, error):
    with pytest.raises(error) as caught:
        DEFAULT.with_(**{name: bad})
    assert str(caught.value).startswith(name) and str(caught.value).endswith(f"not {bad!r}")


def test_stereo_needs_depth():
    assert PAPER_SMALL.with_(stereo=True).stereo
    with pytest.raises(ValueError, match=r"^depth must be True in a machine with stereo, not False$"):
        PAPER_SMALL.with_(stereo=True, depth=False)


def test_read_clients_have_at_most_read_beats():
    assert read_depths(PAPER) == READ_DEPTHS and read_depths(V3) == SUPERTILE_READ_DEPTHS
    few = read_depths(PAPER.with_(read_beats=32))
    assert few == {client: min(depth, 32) for client, depth in READ_DEPTHS.items()} != READ_DEPTHS


def test_banks_in_memories_need_lists_by_tile():
    assert FPGA.bank_memories and not FPGA.supertiles
    with pytest.raises(ValueError, match=r"^bank_memories must be False in a machine with lists by super-tile"):
        V3.with_(bank_memories=True)


def test_chunks_need_an_order_and_compact_records_need_chunks():
    assert PAPER.with_(order="spatial").order == "spatial"
    wide = PAPER.with_(order="spatial", chunks=True)
    assert (wide.chunks, wide.compact, V3_RECORDS.compact) == (True, False, True)
    with pytest.raises(ValueError, match=r"^order must be 'spatial' in a machine with chunks, not 'file'$"):
        PAPER.with_(chunks=True)
    with pytest.raises(ValueError, match=r"^chunks must be True in a machine with compact records, not False$"):
        PAPER.with_(order="spatial", records="compact")


def test_lists_by_super_tile_need_compact_records_and_one_eye():
    assert V3.supertiles and not V3_RECORDS.supertiles and V3_RECORDS.with_(lists="supertile").supertiles
    assert V3_RECORDS == V3.with_(name="v3_records", lists="tile")
    assert TINY_V3.supertiles and TINY_V3.blocks == TINY.blocks
    with pytest.raises(ValueError, match=r"^records must be 'compact' in a machine with lists by super-tile, not 'wide'$"):
        V3.with_(records="wide")
    with pytest.raises(ValueError, match=r"^stereo must be False .* and without joint frames: `paper` renders two eyes$"):
        V3.with_(stereo=True)


def test_a_warped_eye_on_top_of_joint_frames_needs_them_and_excludes_what_was_not_built():
    machine = V3.with_(joint=True, stereo=True)
    assert machine.warps_joint and machine == V3_EYES_WARP.with_(name="v3") and TINY_EYES_WARP.warps_joint
    assert not (PAPER.with_(stereo=True).warps_joint or V3_EYES.warps_joint)
    assert machine.depth_weight == machine.formats.transmittance != V3_EYES.depth_weight
    for name in ("packed", "overlap"):
        with pytest.raises(ValueError, match=r"^stereo must be False in a machine with packed frames or overlapped phases$"):
            machine.with_(**{name: True})
    with pytest.raises(ValueError, match=r"^depth must be True in a machine with stereo, not False$"):
        machine.with_(depth=False)


def test_streams_divide_the_cores_of_a_machine_with_super_tiles():
    one, four = V3, V3.with_(streams=4)
    assert (one.split, one.region, one.array_x, one.array_y, one.batch_banks) == (1, 16, 16, 16, 1)
    assert (four.split, four.region, four.array_x, four.array_y, four.batch_banks) == (2, 8, 8, 8, 8)
    small = TINY_V3.with_(streams=4)
    assert (small.array_x, small.array_y, small.blocks) == (2, 2, TINY_V3.blocks)
    assert (TINY_STREAMS.array_x, TINY_STREAMS.array_y, TINY_STREAMS.blocks) == (TINY_V3.array_x, TINY_V3.array_y, 4)
    for bad in (2, 3):
        with pytest.raises(ValueError, match=rf"^streams must be 1 or 4, not {bad}$"):
            V3.with_(streams=bad)
    for bad in (0, 5):
        with pytest.raises(ValueError, match=rf"^streams must be in 1..4, not {bad}$"):
            V3.with_(streams=bad)
    with pytest.raises(TypeError, match=r"^streams must be an integer, not 4.0$"):
        V3.with_(streams=4.0)
    with pytest.raises(ValueError, match=r"^lists must be 'supertile' in a machine with streams, not 'tile'$"):
        PAPER.with_(streams=4)
    for name in ("cores_x", "cores_y"):
        with pytest.raises(ValueError, match=rf"^{name} must be at least 4 in a machine with streams, not 2$"):
            V3.with_(streams=4, **{name: 2})


def test_machines_with_super_tiles_may_pack_frames():
    assert V3_PACKED == V3.with_(name="v3_packed", packed=True) and not V3.packed
    with pytest.raises(ValueError, match=r"^lists must be 'supertile' in a machine with packed frames, not 'tile'$"):
        PAPER.with_(packed=True)


def test_machines_with_super_tiles_may_render_joint_frames():
    assert V3_EYES == V3.with_(name="v3_eyes", joint=True) and not V3.joint
    assert TINY_EYES == TINY_V3.with_(name="tiny_eyes", joint=True)
    with pytest.raises(ValueError, match=r"^lists must be 'supertile' in a machine with joint frames, not 'tile'$"):
        PAPER.with_(joint=True)
    assert V3_EYES_STREAMS == V3_STREAMS.with_(name="v3_eyes_streams", joint=True, packed=True)
    assert V3_EYES_LARGE == V3_EYES_STREAMS.with_(name="v3_eyes_large", batch_places=2 * V3_EYES_STREAMS.batch_places)
    assert V3_STREAMS_PACKED == V3_STREAMS.with_(name="v3_streams_packed", packed=True, batch_places=V3.batch_places // 2)


def test_phases_may_overlap_in_machines_with_super_tiles():
    assert V3_OVERLAP == V3.with_(name="v3_overlap", overlap=True) and not V3.overlap
    assert TINY_OVERLAP == TINY_V3.with_(name="tiny_overlap", overlap=True)
    with pytest.raises(ValueError, match=r"^lists must be 'supertile' in a machine with overlapped phases, not 'tile'$"):
        PAPER.with_(overlap=True)
    assert V3_EYES_OVERLAP == V3_EYES.with_(name="v3_eyes_overlap", overlap=True)
    assert TINY_EYES_OVERLAP == TINY_EYES.with_(name="tiny_eyes_overlap", overlap=True)


def test_every_parameter_is_covered_here():
    assert {f.name for f in fields(AcceleratorConfig)} == {
        *RANGES, *FLAGS, "name", "support_sigma", "formats", "warp_fill", "order", "records", "lists", "streams"}


def test_frozen_keyword_only_and_hashable():
    with pytest.raises(TypeError):
        AcceleratorConfig("x")
    with pytest.raises(FrozenInstanceError):
        DEFAULT.levels = 2
    assert AcceleratorConfig(name="paper") == PAPER and hash(DEFAULT.with_()) == hash(DEFAULT)
    with pytest.raises(TypeError):
        DEFAULT.with_(cores_z=4)


def test_support_may_be_absent_or_real():
    assert DEFAULT.with_(support_sigma=None).support_sigma is None
    assert DEFAULT.with_(support_sigma=2).support_sigma == 2


def test_the_configurations():
    """PAPER has the source's resources: 16x16 cores, 8 culling units, 64 KB of sorting buffer, 1 KB line buffers, 1920 pixels.
    V3 has them too, and lists by super-tile, as have DEFAULT, with fewer units, and the presets. PAPER_SMALL is PAPER with
    DEFAULT's units. TINY passes over a tile in 16 blocks."""
    presets = {"precise": PRECISE, "balanced": BALANCED, "fast": FAST}
    assert CONFIGS == {"tiny": TINY, "default": DEFAULT, "paper": PAPER, "v3": V3, **presets}
    assert V3 == PAPER.with_(name="v3", order="spatial", chunks=True, records="compact", lists="supertile")
    ours = (DEFAULT, V3, V3_PACKED, V3_STREAMS, V3_STREAMS_PACKED, HEADSET, TINY_V3, TINY_STREAMS, V3_EYES, V3_EYES_STREAMS,
            V3_EYES_LARGE, TINY_EYES, V3_OVERLAP, TINY_OVERLAP, V3_EYES_OVERLAP, TINY_EYES_OVERLAP, V3_EYES_WARP,
            TINY_EYES_WARP, *presets.values())
    assert HEADSET == V3.with_(name="headset", row_width=2208, list_heads=2048)
    assert V3_STREAMS == V3.with_(name="v3_streams", streams=4)
    assert {c.name for c in MACHINES.values() if c.supertiles} == {c.name for c in ours}
    assert all((c.order, c.chunks, c.records) == ("spatial", True, "compact") for c in (*ours, V3_RECORDS))
    assert all((c.order, c.chunks, c.records, c.lists) == ("file", False, "wide", "tile")
               for c in MACHINES.values() if c not in (*ours, V3_RECORDS))
    assert PAPER_SMALL == PAPER.with_(name="paper_small", culling_units=DEFAULT.culling_units, row_width=DEFAULT.row_width,
                                      warp_lanes=2, warp_columns=256)
    assert (PAPER.cores_x, PAPER.cores_y, PAPER.blocks, PAPER.banks) == (16, 16, 1, 2)
    assert (PAPER.culling_units, PAPER.row_width) == (8, 1920)
    assert (PAPER.line_buffer_bytes, PAPER.sort_buffer_bytes) == (1024, 64 * 1024)
    assert (TINY.cores_x, TINY.cores_y, TINY.blocks, TINY.level_banks, TINY.banks) == (4, 4, 16, 2, 32)
    assert (DEFAULT.cores_x, DEFAULT.cores_y, DEFAULT.formats) == (PAPER.cores_x, PAPER.cores_y, PAPER.formats)
    assert DEFAULT.culling_units < PAPER.culling_units and DEFAULT.row_width < PAPER.row_width
    assert all(c.depth and c.levels == 4 and c.support_sigma == 3.0 for c in CONFIGS.values())


def test_banks_follow_levels_and_blocks():
    one_level = TINY.with_(levels=1)
    assert (one_level.level_banks, one_level.banks) == (1, 16)
    assert (DEFAULT.with_(levels=2, cores_x=8).banks, DEFAULT.with_(levels=1).banks) == (4, 1)


@pytest.mark.parametrize(("name", "to"), [("position", "view"), ("work", "view"), ("conic", "view"), ("scale", "work")])
def test_small_floats_longer_than_those_they_enter_are_rejected(name, to):
    n = NumberFormats()
    most = getattr(n, to).sig_bits
    n = replace(n, extent=replace(n.extent, sig_bits=13))
    fitting, long = (replace(n, **{name: replace(getattr(n, name), sig_bits=bits)}) for bits in (most, most + 1))
    assert DEFAULT.with_(formats=fitting).formats == fitting
    with pytest.raises(ValueError, match=rf"^{name} must not have .* than {to}, {most}, not SmallFloat\(sig_bits={most + 1},"):
        DEFAULT.with_(formats=long)


def test_work_is_at_most_twice_as_long_as_an_extent():
    n = NumberFormats()
    assert n.work.sig_bits == 2 * n.extent.sig_bits  # a case at the limit
    with pytest.raises(ValueError, match=r"^work must not have more than twice .* of extent, 9, not SmallFloat\(sig_bits=19,"):
        DEFAULT.with_(formats=replace(n, work=replace(n.work, sig_bits=19)))


def test_presets_are_v3_with_fewer_bits_and_harmonics():
    assert list(PRESETS) == ["precise", "balanced", "fast"]
    degrees = [config.sh_degree for config in PRESETS.values()]
    assert degrees == sorted(degrees, reverse=True) and degrees[0] == V3.sh_degree
    for name, config in PRESETS.items():
        assert config.with_(name="v3", formats=V3.formats, sh_degree=3) == V3 and config.name == name
        widths = [(getattr(config.formats, f.name), getattr(V3.formats, f.name)) for f in fields(NumberFormats)]
        assert all(a <= b if isinstance(a, int) else a.width <= b.width for a, b in widths) and config.formats != V3.formats


@pytest.mark.parametrize("n", [NumberFormats(), SHORT_FORMATS], ids=["default", "short"])
def test_formats_agree_where_the_arithmetic_relies_on_it(n):
    """Relations that docs/array.md and the culling unit use without a shift for them."""
    assert n.cut.frac_bits == n.log2_opacity.frac_bits <= n.exponent.frac_bits
    assert n.factor.frac_bits == n.conic.sig_bits - 1
    assert n.exponent.frac_bits == n.slope.frac_bits == n.curvature.frac_bits
    assert n.conic.exp_max == 0
    assert n.weight.frac_bits <= n.transmittance.frac_bits
    assert (1 << n.cut.frac_bits) % n.exp2_segments == 0
