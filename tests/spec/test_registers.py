"""The register map: addresses, bits, limits; its page and its C header are what spec/ says now."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from msv2.document import registers as document_registers
from msv2.document.__main__ import check
from spec import host_settings, register_fields, registers
from spec.codes import ErrorCode, Phase
from spec.config import (
    CONFIGS,
    DEFAULT,
    MACHINES,
    PAPER,
    TINY,
    TINY_V3,
    V3,
    V3_EYES,
    V3_EYES_WARP,
    V3_OVERLAP,
    V3_PACKED,
    V3_RECORDS,
)
from spec.errors import InputError
from spec.formats import SQ
from spec.memory import frame_settings
from spec.paths import ROOT
from spec.register_fields import Access
from spec.registers import COUNTERS_BASE, EVENTS, SETTINGS_BASE, STAGES
from spec.saturations import SATURATIONS

STEREO = PAPER.with_(name="stereo", stereo=True)
EVERY = host_settings.with_every_register(PAPER)[0].with_(name="every")
MAPS = {config.name: registers.register_map(config)
        for config in (*MACHINES.values(), STEREO, EVERY)}


@pytest.mark.parametrize("path", document_registers.PAGES, ids=lambda path: path.name)
def test_pages_are_not_stale(path, tmp_path):
    make = document_registers.PAGES[path]
    assert path.read_text(encoding="utf-8") == make(), "run `python -m msv2.document`"
    with pytest.raises(InputError, match="stale"):
        check(tmp_path / path.name, make)


@pytest.mark.parametrize("config", MAPS)
def test_addresses_and_bits_do_not_overlap(config):
    everything = MAPS[config]
    offsets = [r.offset for r in everything]
    assert offsets == sorted(set(offsets)) and all(offset % 4 == 0 for offset in offsets)
    assert offsets[-1] + 4 <= 1 << registers.REGISTER_ADDRESS_BITS
    assert len({r.name for r in everything}) == len(everything)
    assert max(r.offset for r in everything if r.format) < COUNTERS_BASE
    for r in everything:
        taken = 0
        for bits in r.bits:
            assert bits.width > 0 and bits.mask < 1 << 32 and not taken & bits.mask, (r.name, bits.name)
            assert bits.values is None or max(bits.values) < 1 << bits.width
            taken |= bits.mask


@pytest.mark.parametrize("config", CONFIGS.values(), ids=lambda c: c.name)
def test_every_number_of_the_settings_has_a_register_in_order(config):
    found = [r for r in MAPS[config.name] if r.format]
    wanted = [f for f in frame_settings(config).fields for _ in range(f.count)]
    assert [r.format for r in found] == [f.format for f in wanted] and len(found) == 51 + 4 * config.chunks - config.supertiles
    places = [n for n, r in enumerate(r for r in MAPS["every"] if r.format) if r.name in {own.name for own in found}]
    last = [len([r for r in MAPS["every"] if r.format])] * config.supertiles  # the address that other machines lack
    assert [r.offset for r in found] == [SETTINGS_BASE + 4 * n for n in (*places, *last)]
    assert config.supertiles or places == list(range(len(found)))
    assert found[3].name == "rotation_0" and found[50 - 2 * config.supertiles].name == "frame_base"
    assert all(r.access is Access.READ_WRITE for r in found)


def test_a_register_has_one_address_in_all_machines():
    """Where a machine has no chunks, no stereo or no splat records in memory, the addresses of their registers are empty."""
    every = {r.name: r.offset for name in ("every", "v3_packed", "v3_eyes", "v3_overlap", "v3_eyes_warp")
             for r in MAPS[name]}
    assert len(set(every.values())) == len(every)
    for everything in MAPS.values():
        assert {r.name: r.offset for r in everything}.items() <= every.items()
    assert set(every) == {r.name for name in ("v3_records", "stereo", "v3_packed", "v3_eyes", "v3_overlap", "v3_eyes_warp")
                          for r in MAPS[name]}
    added = {name: {r.name for r in MAPS[name]} - {r.name for r in MAPS["paper"]} for name in ("v3_records", "stereo")}
    assert added["v3_records"] == {
        "chunks", "chunks_base", "reach_0", "reach_1", "read_beats_chunks", "chunks_read", "chunks_skipped"}
    assert every["chunks"] == every["frame_base"] + 4 and every["stereo"] == every["reach_1"] + 4
    assert every["read_beats_chunks"] == every["pixels"] + 4 and every["cycles_target_low"] == every["chunks_skipped"] + 4
    assert registers.read_clients(EVERY) == (*registers.READ_CLIENTS, "chunks") == registers.read_clients(V3_RECORDS)
    assert registers.read_clients(STEREO) == registers.READ_CLIENTS


def test_what_a_warped_eye_adds_to_joint_frames():
    joint, warped, stereo = ({r.name: r.offset for r in MAPS[name]} for name in ("v3_eyes", "v3_eyes_warp", "stereo"))
    own = {"second_sweep", *registers.SWEEP_EVENTS}
    assert joint.items() < warped.items()
    assert set(warped) - set(joint) - set(stereo) == own
    assert {name for name in warped if name not in joint} == own | (set(stereo) - {r.name for r in MAPS["paper"]} - set(joint))
    assert all(warped[name] > joint["visits"] for name in registers.SWEEP_EVENTS)
    assert registers.version_minor(V3_EYES_WARP) == registers.version_minor(V3_EYES) + 1
    assert registers.stages(V3_EYES_WARP) == (*registers.stages(V3_EYES), "warp")
    limit = next(limit for limit in host_settings.limits(V3_EYES_WARP) if limit.where == "stereo" and limit.setting == "joint")
    assert limit.allows(1) and not limit.allows(0)


def test_what_machines_with_super_tiles_have_besides_and_what_they_lack():
    tiles, own = ({r.name: r.offset for r in MAPS[name]} for name in ("v3_records", "v3"))
    assert set(tiles) - set(own) == {
        "view_shift", "views_base", "read_beats_views", "write_beats_views", "fetch_hits", "fetch_misses"}
    added = {name for name in own if name not in tiles}
    assert added == {"supertiles_base", "batch_busy", "batch_starved", "batch_blocked", *registers.SUPERTILE_EVENTS}
    stereo = {r.offset for r in MAPS["every"]}
    assert not stereo & {own[name] for name in added} and own["supertiles_base"] > max(
        r.offset for r in MAPS["every"] if r.format)
    assert registers.read_clients(V3) == ("geometry", "tiles", "colour", "entries", "spill", "chunks")
    assert registers.write_clients(V3) == ("entries", "spill", "frame")
    assert registers.stages(V3) == registers.SUPERTILE_STAGES == (
        "geometry", "projection", "tile_test", "entry_write", "list_read", "sort", "handover", "fetch", "colour", "batch",
        "array", "pixel_write")
    assert [c.name for c in registers.counters(V3)] == [
        name.removesuffix("_low") for name, offset in own.items() if offset >= COUNTERS_BASE and not name.endswith("_high")]
    assert not {"fetch_hits", "fetch_misses"} & registers.events(V3).keys()
    assert [limit.setting for limit in host_settings.limits(V3)] == ["near", "depth_scale", "width", "height"]


def test_identity_of_machines_with_super_tiles():
    parts = {r.name: r.bits for r in MAPS["tiny_v3"]}

    def value(config, name, bits):
        found = next(b for b in parts[name] if b.name == bits)
        return (registers.identity(config)[name] & found.mask) >> found.low

    for config in (V3, TINY_V3, TINY_V3.with_(buckets=False), V3_RECORDS, PAPER):
        own = config.supertiles
        assert value(config, "machine_array", "supertiles") == own
        assert value(config, "machine_frame", "row_width") == config.row_width
        assert value(config, "machine_frame", "list_heads") == own * config.list_heads
        assert value(config, "machine_frame", "buckets") == (own and config.buckets)
        assert value(config, "machine_cache", "lines") == (config.header_lines if own else config.splat_cache_lines)
        assert value(config, "machine_cache", "batch_places") == own * config.batch_places


def test_machines_that_pack_frames_have_one_more_setting_and_say_so():
    plain, packed = ({r.name: r.offset for r in registers.register_map(config)} for config in (V3, V3_PACKED))
    assert set(packed) - set(plain) == {"packed"} and plain.items() <= packed.items()
    assert packed["packed"] == plain["supertiles_base"] + 4
    bit = next(b for r in MAPS["v3"] for b in r.bits if b.name == "packed")
    for config in (V3, V3_PACKED, TINY_V3, PAPER):
        assert bool(registers.identity(config)["machine_array"] & bit.mask) == config.packed
        assert registers.identity(config)["version"] & 0xFFFF == 2 * config.packed
    patterns = legal(V3_PACKED)
    display = next(s.number for s in host_settings.settings(V3_PACKED) if s.name == "display")
    for is_packed, shown, found in ((0, 0, None), (0, 1, None), (1, 1, None), (1, 0, display)):
        assert host_settings.first_illegal(V3_PACKED, patterns | {"packed": is_packed, "display": shown}) == found


def test_machines_with_joint_frames_have_the_target_eyes_settings_and_say_so():
    plain, joint = ({r.name: r.offset for r in registers.register_map(config)} for config in (V3, V3_EYES))
    target = {"target_position_0", "target_position_1", "target_position_2", "target_tiles_base", "target_frame_base"}
    assert set(joint) - set(plain) == target | {"joint", "shift", "shared_colour"} and plain.items() <= joint.items()
    bit = next(b for r in MAPS["v3"] for b in r.bits if b.name == "joint")
    for config in (V3, V3_EYES, TINY_V3, PAPER):
        assert bool(registers.identity(config)["machine_units"] & bit.mask) == config.joint
        assert registers.identity(config)["version"] & 0xFFFF == 4 * config.joint
    assert registers.fingerprint(V3_EYES) != registers.fingerprint(V3) == 0x49653B21
    patterns, number = legal(V3_EYES), next(s.number for s in host_settings.settings(V3_EYES) if s.name == "shift")
    for is_joint, shift, found in (
            (0, 9, None), (1, 0, None), (1, 8, None), (1, 9, number), (1, -9 & 31, number), (1, -8 & 31, None), (1, 31, None)):
        assert host_settings.first_illegal(V3_EYES, patterns | {"joint": is_joint, "shift": shift}) == found


def test_machines_whose_phases_overlap_have_one_more_client_and_say_so():
    plain, overlap = ({r.name: r.offset for r in registers.register_map(config)} for config in (V3, V3_OVERLAP))
    assert set(overlap) - set(plain) == {"read_beats_first"} and plain.items() <= overlap.items()
    assert registers.read_clients(V3_OVERLAP) == (*registers.read_clients(V3), "first")
    bit = next(b for r in MAPS["v3"] for b in r.bits if b.name == "overlap")
    for config in (V3, V3_OVERLAP, TINY_V3, PAPER):
        assert bool(registers.identity(config)["machine_units"] & bit.mask) == config.overlap
        assert registers.identity(config)["version"] & 0xFFFF == 8 * config.overlap
    assert registers.fingerprint(V3_OVERLAP) != registers.fingerprint(V3)
    assert Phase.width() <= next(b for r in MAPS["v3"] for b in r.bits if b.name == "first_phase").width


@pytest.mark.parametrize("name", document_registers.MAKERS)
def test_every_document_of_a_machine_that_packs_frames_has_the_setting(name):
    text = document_registers.MAKERS[name](V3_PACKED)
    assert "packed" in text.lower() and text != document_registers.MAKERS[name](V3)


def test_a_setting_that_does_not_fit_is_refused():
    wide = PAPER.with_(formats=replace(PAPER.formats, mean2d=SQ(22, 10)))
    with pytest.raises(ValueError, match="centre_0 must fit a register of 32 bits, not 33"):
        host_settings.settings(wide)


def test_counters():
    names = [c.name for c in registers.counters(PAPER)]
    assert len(set(names)) == len(names) and set(EVENTS) < set(names)
    assert all(f"{stage}_{what}" in names for stage in STAGES for what in ("busy", "starved", "blocked"))
    mapped = {r.name: r.offset for r in MAPS["paper"]}
    assert mapped["cycles_total_high"] == mapped["cycles_total_low"] + 4 == COUNTERS_BASE + 4
    saturations = [mapped[saturation.name] for saturation in SATURATIONS]
    assert saturations == [registers.SATURATIONS_BASE + 4 * n for n in range(4)] == list(mapped.values())[-4:]
    assert sum(c.width // 32 for c in registers.counters(PAPER)) == sum(r.offset >= COUNTERS_BASE for r in MAPS["paper"])


def legal(config) -> dict[str, int]:
    """Patterns that are all allowed."""
    patterns = {s.name: 0 for s in host_settings.settings(config)}
    return patterns | {limit.setting: limit.low for limit in host_settings.limits(config)}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=lambda c: c.name)
def test_the_first_illegal_setting_is_named(config):
    numbers = {s.name: s.number for s in host_settings.settings(config)}
    assert host_settings.first_illegal(config, legal(config)) is None
    limits = host_settings.limits(config)
    assert [numbers[limit.setting] for limit in limits] == sorted(numbers[limit.setting] for limit in limits)
    for limit in limits:
        for pattern, allowed in ((limit.low, True), (limit.high, True), (limit.low - 1, False), (limit.high + 1, False)):
            if pattern >= 0:
                found = host_settings.first_illegal(config, legal(config) | {limit.setting: pattern})
                assert found == (None if allowed else numbers[limit.setting]), limit
    worst = legal(config) | {limit.setting: limit.high + 1 for limit in limits}
    assert host_settings.first_illegal(config, worst) == numbers["near"]


def test_limits_of_floats_are_those_of_their_numbers():
    limits, view = {limit.setting: limit for limit in host_settings.limits(PAPER)}, PAPER.formats.view
    for x in (-1e9, -1e-30, 0.0, 1e-30, 0.01, 1.0, 1e9):
        pattern = int(view.quantise(x))
        assert limits["near"].allows(pattern) == (x > 0)
        assert limits["depth_scale"].allows(pattern) == (x >= 0)


def test_identity_tells_machines_apart():
    for config in CONFIGS.values():
        values = registers.identity(config)
        assert set(values) == {r.name for r in MAPS[config.name] if r.offset < register_fields.CONTROL_BASE}
        assert all(0 <= value < 1 << 32 for value in values.values())
    assert registers.identity(TINY)["machine_array"] == 4 | 4 << 8 | 4 << 16 | 7 << 20 | 3 << 24 | 1 << 26
    compact, wide = registers.identity(V3_RECORDS), registers.identity(PAPER.with_(order="spatial", chunks=True))
    assert (compact["machine_array"], wide["machine_array"]) == tuple(
        registers.identity(PAPER)["machine_array"] | flags << 27 for flags in (3, 1))
    prints = {registers.fingerprint(c) for c in (TINY, DEFAULT, PAPER, PAPER.with_(depth=False))}
    assert len(prints) == 4 and registers.fingerprint(PAPER.with_(name="same")) == registers.fingerprint(PAPER)


def test_the_page_shows_everything():
    page = document_registers.page()
    for r in {r.offset: r for name in ("v3", "every") for r in MAPS[name]}.values():
        assert re.search(rf"^\| 0x{r.offset:03X} \|.* `{r.name}` \|", page, re.MULTILINE), r.name
        assert all(f"`.{bits.name}`" in page for bits in r.bits if not r.format)
        having = {name for name in ("paper", "v3_records", "stereo", "v3") if r.name in {other.name for other in MAPS[name]}}
        line, = (line for line in page.splitlines() if line.startswith(f"| 0x{r.offset:03X} |"))
        told = {"only with chunks": {"v3_records", "v3"}, "only with stereo": {"stereo"},
                "only with super-tiles": {"v3"},
                "not with super-tiles": {"paper", "v3_records", "stereo"}}
        assert {words for words in told if words in line} == {words for words, names in told.items() if names == having}, r.name
    for value in (*Phase, *ErrorCode):
        assert f"| {int(value)} | `{value.name}` |" in page


def test_the_header_shows_everything():
    header = document_registers.header()
    macros = re.findall(r"^#define (\w+) (\S+)$", header, re.MULTILINE)
    assert len(dict(macros)) == len(macros)
    for r in (*MAPS["every"], *MAPS["v3"]):
        assert dict(macros)[f"MSV2_{r.name.upper()}"] == f"0x{r.offset:03X}u"
    assert dict(macros)["MSV2_CONTROL_ENABLE_ERROR_MASK"] == "0x00000200u"
    assert (Phase.width(), ErrorCode.width()) == (3, 4)
    assert "MSV2_ERROR_BAD_SETTING = 1," in header and "MSV2_PHASE_RENDER = 4," in header


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
def test_the_header_compiles(tmp_path):
    probe = tmp_path / "probe.c"
    probe.write_text('#include "msv2_registers.h"\n#include "msv2_registers.h"\n'
                     "int main(void) { return MSV2_FRAME_BASE != MSV2_SETTINGS_BASE + 4 * (MSV2_SETTINGS_COUNT - 1)\n"
                     "    || MSV2_ERROR_ABORTED != 7 || MSV2_READ_CLIENT_VIEWS != MSV2_READ_CLIENTS - 1\n"
                     "    || MSV2_READ_CLIENT_CHUNKS != MSV2_CHUNKS_READ_CLIENTS - 1\n"
                     "    || MSV2_SUPERTILE_READ_CLIENT_CHUNKS != 5 || MSV2_SUPERTILE_WRITE_CLIENT_FRAME != 2; }\n")
    program = tmp_path / "probe"
    subprocess.run(["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{ROOT / 'docs'}", probe, "-o", program],
                   check=True)
    assert subprocess.run([program], check=False).returncode == 0
