"""Names are read out of wave files, and the set-up files for GTKWave name the signals of streams that a trace has."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from spec.config import TINY
from tb.common.fst import Signal, lz4_block, signals
from tb.common.runner import WAVES_FILE, Waves
from tb.common.wave_view import groups, view_path, view_text, write_view
from tb.sort_tmu import tile_merge_suite

needs_gtkwave = pytest.mark.skipif(
    any(shutil.which(tool) is None for tool in ("vcd2fst", "fst2vcd")), reason="needs GTKWave: apt-get install gtkwave")
needs_screen = pytest.mark.skipif(
    any(shutil.which(tool) is None for tool in ("gtkwave", "xvfb-run")), reason="needs apt-get install gtkwave xvfb")

STREAM = ("hits__payload[10:0]", "hits__payload.tile[9:0]", "hits__payload.end", "hits__valid", "hits__ready")


def trace(*names: str, scope: tuple[str, ...] = ("tb", "dut"), way: str = "") -> list[Signal]:
    found = []
    for name in names:
        head, bracket, tail = name.partition("[")
        found.append(Signal(scope, head, bracket + tail, way))
    return found


def vcd(count: int) -> str:
    """A VCD file of three nested scopes, whose innermost has `count` signals beside a stream."""
    names = [*STREAM, *(f"word_{number}[31:0]" for number in range(count))]
    lines = ["$timescale 1ns $end", "$scope module tb $end", "$var wire 1 ! clk $end", "$scope module dut $end",
             "$var wire 1 ! clk $end", "$scope module inner $end"]
    for number, name in enumerate(names):
        head, bracket, tail = name.partition("[")
        width = int(tail.partition(":")[0]) + 1 if bracket else 1
        lines.append(f"$var wire {width} s{number} {head} {bracket + tail} $end".replace("  ", " "))
    return "\n".join([*lines, *["$upscope $end"] * 3, "$enddefinitions $end", "#0", "1!", "#5", "0!", "#10", "1!"]) + "\n"


@needs_gtkwave
@pytest.mark.parametrize("pack", ["", "--fourpack"])
@pytest.mark.parametrize("count", [1, 20_000])
def test_names_are_read_from_files_of_another_writer(pack: str, count: int, tmp_path: Path) -> None:
    """Hierarchies in gzip, in LZ4 and, where they are long, in LZ4 of LZ4."""
    (tmp_path / "x.vcd").write_text(vcd(count))
    subprocess.run(["vcd2fst", *pack.split(), "x.vcd", "x.fst"], cwd=tmp_path, check=True, capture_output=True)
    found = signals(tmp_path / "x.fst")
    inner = [signal.path for signal in found if signal.scope == ("tb", "dut", "inner")]
    assert inner == [f"tb.dut.inner.{name}" for name in (*STREAM, *(f"word_{number}[31:0]" for number in range(count)))]
    assert [signal.path for signal in found if len(signal.scope) < 3] == ["tb.clk", "tb.dut.clk"]


def test_lz4_with_matches() -> None:
    """Three literals, a match that overlaps itself, a long match, and the literals at the end."""
    packed = bytes([0x35]) + b"abc" + bytes([3, 0]) + bytes([0x0F]) + bytes([12, 0, 2]) + bytes([0x20]) + b"xy"
    text = b"abc" * 4 + (b"abc" * 7) + b"xy"
    assert lz4_block(packed, len(text)) == text
    with pytest.raises(ValueError, match="must have 3 bytes"):
        lz4_block(packed, 3)


@pytest.mark.parametrize("data", [b"", b"no wave file at all", bytes([0]) + (329).to_bytes(8, "big") + bytes(321)])
def test_a_file_without_a_hierarchy_is_refused(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.fst").write_bytes(data)
    with pytest.raises(ValueError, match=r"x\.fst must be an FST file"):
        signals(tmp_path / "x.fst")


def test_a_stream_of_the_unit_is_a_group() -> None:
    found = [*trace("clk", "rst", "hits__valid", "hits__payload[10:0]", "busy", way="input"), *trace(*STREAM[1:3]),
             *trace("hits__ready", way="output"), *trace("hits__valid$3", "counter[7:0]")]
    made = {group.name: [(radix, signal.name) for radix, signal in group.shown] for group in groups(found)}
    assert made == {
        "clock and reset": [("@28", "clk"), ("@28", "rst")],
        "hits": [("@28", "hits__valid"), ("@28", "hits__ready"), ("@22", "hits__payload"), ("@24", "hits__payload.tile"),
                 ("@28", "hits__payload.end")],
        "other ports": [("@28", "busy")]}


def test_a_channel_of_a_bus_is_a_group() -> None:
    names = ("m_axi_arvalid", "m_axi_arready", "m_axi_araddr[31:0]", "m_axi_arid[2:0]", "m_axi_rvalid", "m_axi_rready",
             "m_axi_rdata[255:0]", "s_axil_wvalid", "s_axil_wready", "s_axil_wdata[31:0]", "s_axil_wstrb[3:0]", "invalid",
             "valid")
    made = {group.name: [(radix, signal.name) for radix, signal in group.shown]
            for group in groups([*trace("clk"), *trace(*names, way="output")])}
    assert made["m_axi_ar"] == [("@28", "m_axi_arvalid"), ("@28", "m_axi_arready"), ("@22", "m_axi_araddr"),
                                 ("@24", "m_axi_arid")]
    assert made["m_axi_r"][-1] == ("@22", "m_axi_rdata")
    assert [name for _, name in made["s_axil_w"]] == ["s_axil_wvalid", "s_axil_wready", "s_axil_wdata", "s_axil_wstrb"]
    assert [name for _, name in made["other ports"]] == ["invalid", "valid"]


def test_streams_inside_are_in_closed_groups_by_unit() -> None:
    found = [*trace("clk", way="input"), *trace(*STREAM, scope=("tb", "dut", "sorter", "runs")), *trace(*STREAM, scope=("tb",))]
    text = view_text(Path("x/dump.fst"), found)
    begin, end = text.index("@c00200\n-sorter/runs\n"), text.index("@1401200\n-sorter/runs\n")
    assert all(f"\ntb.dut.sorter.runs.{name}\n" in text[begin:end] for name in STREAM)
    assert "\ntb.hits__" not in text and "\ntb.dut.clk\n" in text[:begin]


def test_a_trace_without_a_clock_has_no_groups() -> None:
    assert groups(trace(*STREAM)) == []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Waves of a run of the tile merge unit."""
    folder = tmp_path_factory.mktemp("waves")
    plan = [item for item in tile_merge_suite.unit_plan(TINY, 0) if item.name == "random 0"]
    assert not tile_merge_suite.run_plan(TINY, plan, folder, waves=Waves(0, 2000)).failures
    return folder / WAVES_FILE


def named_in(view: Path) -> list[str]:
    """The signals that a set-up file names."""
    return [line for line in view.read_text().splitlines() if line.startswith("tb.")]


@needs_gtkwave
@pytest.mark.long
def test_the_view_of_a_simulation_names_what_its_waves_have(recorded: Path) -> None:
    """Half a minute: a simulator with waves is built. `fst2vcd` is the judge of the names."""
    said = subprocess.run(["fst2vcd", str(recorded)], check=True, capture_output=True, text=True).stdout
    scopes, here = [], set()
    for words in (line.split() for line in said.partition("$enddefinitions")[0].splitlines()):
        if words[:1] == ["$scope"]:
            scopes.append(words[2])
        elif words[:1] == ["$upscope"]:
            scopes.pop()
        elif words[:1] == ["$var"]:
            here.add(".".join((*scopes, "".join(words[4:-1]))))
    named = named_in(view_path(recorded))
    assert set(named) <= here and len(named) == len(set(named))
    for stream, fields in (("hits", ("tile[9:0]", "end")), ("groups", ("tile[9:0]", "count[23:0]", "group[9:0]", "last"))):
        assert {f"tb.dut.{stream}__{part}" for part in ("valid", "ready", *(f"payload.{one}" for one in fields))} <= set(named)


@needs_screen
@pytest.mark.long
def test_gtkwave_loads_the_view(recorded: Path, tmp_path: Path) -> None:
    """GTKWave on a virtual screen finds every signal: it drops those that the waves do not have."""
    script, view = tmp_path / "count.tcl", write_view(recorded)
    script.write_text("puts \"traces [ gtkwave::getTotalNumTraces ]\"\nexit\n")
    said = subprocess.run(
        ["xvfb-run", "-a", "gtkwave", str(view), "--script", str(script)], check=False, capture_output=True, text=True,
        timeout=120, env=os.environ | {"HOME": str(tmp_path)}).stdout
    labels = sum(line.startswith("-") for line in view.read_text().splitlines())
    assert f"traces {len(named_in(view)) + labels}\n" in said
