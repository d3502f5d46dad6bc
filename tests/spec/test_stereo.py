"""What machines with stereo have besides, and that the others have none of it."""

from __future__ import annotations

from fractions import Fraction

import pytest

from spec import host_settings, registers, stereo
from spec.config import MACHINES, PAPER, NumberFormats
from spec.memory import MEMORY_RECORDS
from spec.records import RECORDS

PLAIN = [c for c in MACHINES.values() if c.depth and not c.supertiles and not c.lockstep and not c.stereo]
PAIRS = [(c, c.with_(stereo=True)) for c in PLAIN]


@pytest.mark.parametrize(("plain", "both"), PAIRS, ids=[c.name for c in PLAIN])
def test_records_only_grow_at_their_end(plain, both):
    grown = set()
    for make in (*RECORDS, *MEMORY_RECORDS):
        fields = make(plain).fields
        assert make(both).fields[: len(fields)] == fields
        grown |= {make(plain).name} if len(make(both).fields) > len(fields) else set()
    assert grown >= {"TileSetting", "FrameSettings"}


@pytest.mark.parametrize(("plain", "both"), PAIRS, ids=[c.name for c in PLAIN])
def test_the_map_of_a_machine_without_stereo_is_part_of_the_other(plain, both):
    small, large = ({r.name: r.offset for r in registers.register_map(c)} for c in (plain, both))
    assert small.items() < large.items()
    last = max(offset for offset in small.values() if offset < registers.SATURATIONS_BASE)
    assert min(large[name] for name in set(large) - set(small)) > small["frame_base"]
    assert all(large[name] > last for name in set(large) - set(small) if large[name] >= registers.COUNTERS_BASE)
    more = [c.name for c in registers.counters(both) if c not in registers.counters(plain)]
    assert more == ["cycles_target", "write_beats_warp", "warp_busy", "warp_starved", "warp_blocked", *registers.STEREO_EVENTS]
    assert registers.write_clients(both) == (*registers.write_clients(plain), "warp")
    assert registers.stages(both) == (*registers.stages(plain), "warp")


def test_identity():
    plain, both = (registers.identity(c) for c in (PAPER, PAPER.with_(stereo=True)))
    assert both["version"] == plain["version"] + 1
    assert both["machine_array"] == plain["machine_array"] | 1 << 23
    assert both["machine_units"] == plain["machine_units"] | PAPER.warp_lanes << 24
    assert plain["machine_units"] >> 24 == 0


def test_frames_of_two_eyes_are_display_frames():
    config = PAPER.with_(stereo=True)
    patterns = {s.name: 0 for s in host_settings.settings(config)} | {
        limit.setting: limit.low for limit in host_settings.limits(config) if not limit.where}
    display = next(s.number for s in host_settings.settings(config) if s.name == "display")
    for two_eyes, shown, found in ((0, 0, None), (0, 1, None), (1, 1, None), (1, 0, display)):
        assert host_settings.first_illegal(config, patterns | {"stereo": two_eyes, "display": shown}) == found
    assert not any(limit.where for limit in host_settings.limits(PAPER))


def test_tests_of_coverage_are_exact():
    n = NumberFormats()
    one = 1 << n.transmittance.frac_bits
    for raw in range(n.transmittance.raw_max + 1):
        coverage = 1 - Fraction(raw, one)
        assert (raw >= stereo.background_transmittance(n)) == (coverage < Fraction(1, 255))
        assert (raw <= stereo.solid_transmittance(n)) == (coverage >= Fraction(1, 2))


@pytest.mark.parametrize("width", [16, 255, 256, 511, 512, 1280, 1920, 8191, 8192])
def test_what_saturates_is_out_of_reach(width):
    for columns in (64, 512, 8192):
        config = PAPER.with_(row_width=width, warp_columns=columns)
        raw, most = stereo.disparity(config).raw_max, stereo.reach(config)
        assert most == columns * 3 // 4 if columns < width else most >= width - 1
        for sign in (-1, 1):
            shift = abs(sign * raw + 128 >> stereo.DISPARITY_FRAC)
            assert shift > most and shift.bit_length() == most.bit_length() + 1


def test_the_largest_scale_moves_everything_out_of_frames_of_1023_pixels():
    n = NumberFormats()
    scale, most, weight = (1 << stereo.DISPARITY_SCALE_BITS) - 1, n.depth_accumulator.raw_max, n.transmittance.raw_max
    assert (scale * weight >> stereo.disparity_drop(n)) // most >> stereo.DISPARITY_FRAC >= 1023
