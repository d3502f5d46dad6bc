"""The flow on the pixel core: two netlists of different cells behave alike, and the numbers promised are met."""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")

from rtl.emit import to_rtlil
from rtl.vrc_array.pixel_core import PixelCore
from spec.config import PAPER_SMALL
from spec.errors import InputError
from synth import flow, timing
from synth.__main__ import main
from synth.hints import BLOCKS, SYNTHESISED
from synth.liberty import ASAP7, PDK_VARIABLE, merge
from synth.report import synthesise_unit

needs_pdk = pytest.mark.skipif(not os.environ.get(PDK_VARIABLE), reason=f"{PDK_VARIABLE} names no folder of liberty files")
needs_sta = pytest.mark.skipif(not timing.available(), reason="sta (package opensta) is not installed")

GENERIC = {"$_NAND_": {"Y": "~(A & B)"}, "$_NOT_": {"Y": "~A"}, "$_BUF_": {"Y": "A"}}
LANES = 64


class Simulation:
    """Cycles of a flat netlist in JSON, LANES independent copies at once (a bit of each integer).

    `functions`: expressions by cell and output pin. Flip-flops: $_DFF_P_, DFFHQN (inverted output), clock gates as enables.
    """

    def __init__(self, module: dict, functions: dict[str, dict[str, str]]):
        self.ports = module["ports"]
        cells = module["cells"].values()
        gates = {c["connections"]["GCLK"][0]: c["connections"]["ENA"][0] for c in cells if "GCLK" in c["connections"]}
        self.flops, lines, ready, waiting = [], [], set(), []
        for cell in cells:
            pins = {pin: bits[0] for pin, bits in cell["connections"].items() if bits}
            if cell["type"] in ("$_DFF_P_", ASAP7.flop):
                clock, output = (pins["C"], pins["Q"]) if "C" in pins else (pins["CLK"], pins["QN"])
                self.flops.append((pins["D"], output, gates.get(clock), "QN" in pins))
                ready.add(output)
            elif "GCLK" not in pins:
                inputs = {bit for pin, bit in pins.items() if cell["port_directions"][pin] == "input"}
                waiting.append((cell["type"], pins, inputs))
        ready |= {"0", "1"} | {bit for port in self.ports.values() if port["direction"] == "input" for bit in port["bits"]}
        while waiting:
            blocked = []
            for kind, pins, inputs in waiting:
                if inputs <= ready:
                    for pin, function in functions[kind].items():
                        if pin in pins:
                            value = re.sub(r"[A-Z][A-Z0-9]*", lambda m, pins=pins: f"n[{pins[m[0]]!r}]", function)
                            lines.append(f" n[{pins[pin]!r}] = {value}")
                            ready.add(pins[pin])
                else:
                    blocked.append((kind, pins, inputs))
            assert len(blocked) < len(waiting), "a loop of gates"
            waiting = blocked
        scope: dict[str, Callable] = {}
        exec("def settle(n):\n" + "\n".join(lines), scope)
        self._settle, self.nets = scope["settle"], {"0": 0, "1": -1, **{output: 0 for _, output, _, _ in self.flops}}

    def cycle(self, stimulus: dict[str, list[int]]) -> dict[str, list[int]]:
        """Outputs for these inputs (per port, a LANES wide integer for every bit), then a clock edge."""
        for port, values in stimulus.items():
            self.nets.update(zip(self.ports[port]["bits"], values, strict=True))
        self._settle(self.nets)
        mask, n = (1 << LANES) - 1, self.nets
        outputs = {name: port["bits"] for name, port in self.ports.items() if port["direction"] == "output"}
        seen = {name: [n[bit] & mask for bit in bits] for name, bits in outputs.items()}
        following = []
        for data, output, enable, inverted in self.flops:
            on = -1 if enable is None else n[enable]
            following.append((output, n[output] & ~on | (~n[data] if inverted else n[data]) & on))
        n.update(following)
        return seen


def library_functions(liberty: Path) -> dict[str, dict[str, str]]:
    """Output expressions of every cell of a liberty file, in Python's operators."""
    functions: dict[str, dict[str, str]] = {}
    cell = pin = ""
    for line in liberty.read_text().splitlines():
        if found := re.match(r"\s*cell \((\w+)\)", line):
            cell = found[1]
        elif found := re.match(r"\s*pin \((\w+)\)", line):
            pin = found[1]
        elif found := re.match(r'\s*function : "(.*)"', line):
            functions.setdefault(cell, {})[pin] = found[1].translate(str.maketrans("!*+", "~&|"))
    return functions


def stimulus(rng: random.Random, ports: dict, cycle: int) -> dict[str, list[int]]:
    """Random inputs; exponents mostly where alpha is neither 0 nor 1, both banks started at the beginning."""
    values = {name: [rng.getrandbits(LANES) for _ in port["bits"]] for name, port in ports.items()
              if port["direction"] == "input" and name not in ("clk", "rst")}
    sign, often = rng.getrandbits(LANES), rng.getrandbits(LANES) | rng.getrandbits(LANES)
    top = values["exponent"]
    for i in range(17, len(top)):
        top[i] = top[i] & ~often | sign & often
    both = (1 << LANES) - 1
    for op in ("blend_op", "sum_op"):
        read, write = values[op][0:2], values[op][2:4]
        bank = rng.getrandbits(LANES)
        first = both if cycle < 8 else rng.getrandbits(LANES) & rng.getrandbits(LANES) & rng.getrandbits(LANES)
        bank = (both if cycle % 2 else 0) if cycle < 8 else bank
        read[0], read[1], write[0], write[1] = ~bank & ~first & both, bank & ~first, ~bank & both, bank
        values[op][0:4] = [*read, *write]
        if op == "blend_op":
            values[op][4] = first
            values[op][5] &= rng.getrandbits(LANES) & rng.getrandbits(LANES)
    return values


@needs_pdk
def test_netlist_of_library_cells_behaves_like_nand_gates(tmp_path: Path) -> None:
    """The mapped core against Yosys' own techmap of the same RTL, 64 random histories, every output in every cycle."""
    rtlil, blocks = to_rtlil(PixelCore(PAPER_SMALL), "pixel_core"), BLOCKS["pixel_core"]
    liberty = merge(ASAP7, tmp_path / "asap7.lib")
    flow.synthesise(rtlil, "pixel_core", ASAP7, liberty, tmp_path, blocks)
    flow.count_nand2(rtlil, "pixel_core", tmp_path)
    mapped, plain = (json.loads((tmp_path / f"pixel_core{suffix}.json").read_text())["modules"]["pixel_core"]
                     for suffix in ("", "-generic"))
    ours, reference = Simulation(mapped, library_functions(liberty)), Simulation(plain, GENERIC)
    rng, toggled = random.Random(3), set()
    for cycle in range(200):
        inputs = stimulus(rng, mapped["ports"], cycle)
        got, expected = ours.cycle(inputs), reference.cycle(inputs)
        if cycle >= 12:  # both banks have had a first op in every register
            assert got == expected, f"cycle {cycle}"
            toggled |= {(name, i) for name, bits in got.items() for i, bit in enumerate(bits) if 0 < bit < (1 << LANES) - 1}
    assert len(toggled) > 0.95 * sum(len(port["bits"]) for port in mapped["ports"].values() if port["direction"] == "output")


@needs_pdk
@needs_sta
def test_pixel_core_meets_its_numbers(tmp_path: Path) -> None:
    """At most 450 um^2 under the strict list with slack at 1,000 ps; the second run comes from the cache."""
    report = synthesise_unit("pixel_core", "asap7", 1000.0, tmp_path)
    assert report["area_um2"] <= 450 and report["slack_ps"] >= 0
    assert report["derated_ps"] == pytest.approx(1.15 * report["zero_slack_ps"], abs=0.1)
    assert not [cell for cell in report["cells_by_type"] if re.match(r".*xp|HB|CKINV", cell)]
    assert {cell for cell in report["cells_by_type"] if "DFF" in cell} == {"DFFHQNx1_ASAP7_75t_R"}
    smaller = report["variants"]
    assert smaller["levels=1, depth=False"]["area_um2"] < smaller["depth=False"]["area_um2"] < report["area_um2"]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("cache/*/result.json")}
    assert synthesise_unit("pixel_core", "asap7", 1000.0, tmp_path) == report
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.glob("cache/*/result.json")}


def test_generic_counts_nand2(tmp_path: Path) -> None:
    report = synthesise_unit("pixel_core", "generic", 1000.0, tmp_path)
    assert json.loads((tmp_path / "pixel_core-generic.json").read_text()) == report
    assert 5_000 < report["nand2_equivalents"] < 20_000
    assert report["variants"]["depth=False"]["nand2_equivalents"] < report["nand2_equivalents"]


@pytest.mark.parametrize("options, message", [
    (["--unit", "nothing"], f"unit 'nothing' is not known: {', '.join(SYNTHESISED)} are"),
    (["--unit", "msv2_top"], "unit 'msv2_top' is synthesised as a machine"),
    (["--tech", "tsmc"], "technology 'tsmc' is not known: generic, asap7, nangate45, osu018 are, and files *.lib"),
    (["--clock-ps", "0"], "a clock of 0.0 ps is not accepted"),
    (["--tech", "asap7"], "MSV2_PDK must name the folder"),
    (["--tech", "nangate45"], "lambdapdk"),
    (["--tech", "no/such.lib"], "a liberty file is wanted, not 'no/such.lib'"),
    (["--config", "huge"], "config 'huge' is not accepted: choose one of tiny, default, paper, v3, precise, balanced, fast"),
    (["--config", "tiny", "--set", "sh_degre=1"], "did you mean 'sh_degree'?"),
    (["--set", "sh_degree=1"], "set 'sh_degree=1' is not accepted without config"),
    (["--config", "tiny", "--unit", "expand"], "one of unit and config is accepted"),
    (["--jobs", "0"], "jobs must be at least 1, not 0"),
])
def test_bad_requests_end_with_status_2(options: list[str], message: str, tmp_path: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if key != PDK_VARIABLE}
    done = subprocess.run([sys.executable, "-m", "synth", *options, "--out", str(tmp_path)], capture_output=True, text=True,
                          check=False, env=environment)
    assert done.returncode == 2 and done.stderr.startswith("error: ") and message in done.stderr
    assert not list(tmp_path.iterdir())


def test_absent_liberty_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PDK_VARIABLE, str(tmp_path))
    with pytest.raises(InputError, match=r"asap7sc7p5t_SIMPLE_RVT_TT_nldm\.lib"):
        merge(ASAP7, tmp_path / "merged.lib")


def test_absent_yosys_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "libyosys", None)
    with pytest.raises(InputError, match="extra 'synth'"):
        synthesise_unit("pixel_core", "generic", 1000.0, tmp_path)


@needs_pdk
def test_without_sta_slack_is_null_and_the_package_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """The timing tool is looked for where the netlist is made, in a process of its own: hidden by an empty PATH."""
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["--unit", "vrc_row", "--tech", "asap7", "--out", str(tmp_path / "out")]) == 0
    assert "opensta" in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "vrc_row-asap7.json").read_text())
    assert report["slack_ps"] is None and report["area_um2"] > 0
