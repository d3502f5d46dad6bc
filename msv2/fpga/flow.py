"""From the system around the machine to a bitstream: firmware, synthesis, place and route, packing.

Each step keeps what it made in the folder, with a hash of what it was made of. A run that was interrupted goes on with the step
that it was in, and a run after a change begins with the first step that the change concerns.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from golden.scenes.files import read_json
from golden.scenes.request import write_json
from msv2.fpga import tools
from msv2.studies.fpga.measure import COMMANDS, FAMILIES
from rtl.emit import to_rtlil
from rtl.soc.system import FIRMWARE_WORDS, System
from spec.config import AcceleratorConfig
from spec.errors import InputError
from spec.paths import DOCS, ROOT
from spec.progress import phase
from synth import flow as yosys

TOP = "system"
SOURCES = ROOT / "examples" / "fpga"
DRIVER = ROOT / "examples" / "driver"

CLOCK_MHZ = 50
BAUD = 115200
DIVISOR = round(CLOCK_MHZ * 1e6 / BAUD)
"""Cycles of a bit on the serial line."""

SHALLOW = 40
"""Words of the largest memories that are left to Yosys' choice, which is LUTs. Blocks of memory lie in a few rows of the chip,
and wires to them are long."""

LOGIC_PS = 5000
"""What ABC is told that logic between two registers may take, in ps. Wires, which it does not know, take the rest."""

ROUTER = {
    "router": "router2", "router2/initCurrCongWeight": "4.5", "router2/currCongWeightMult": "0.15",
    "router2/histCongWeight": "2.0", "router2/estimateWeight": "1.0", "router2/bbMargin/x": "15", "router2/bbMargin/y": "15"}
"""nextpnr's settings for routing, which no option of its command line sets. Its own weights raise the cost of a wire that
several nets want so fast that nets only push each other around, and its own margin keeps a net too close to its pins to go
round what is full."""

_CLOCK = ("--freq", CLOCK_MHZ, "--lpf-allow-unconstrained", "--timing-allow-fail")

_FIRMWARE_SOURCES = (SOURCES / "start.S", SOURCES / "firmware.c", DRIVER / "msv2_driver.c")
_FIRMWARE_OTHERS = (SOURCES / "firmware.ld", DRIVER / "msv2_driver.h", DOCS / "msv2_registers.h")
_WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wshadow")


@dataclass(frozen=True)
class Device:
    """A part of the family ECP5.

    Attributes:
        name: the part.
        options: what nextpnr is told.
        lut, ff, bram, dsp: what the part has: four-input LUTs, flip-flops, blocks of 18 Kbit, multipliers of 18 by 18 bits.
    """

    name: str
    options: tuple[str, ...]
    lut: int = 83640
    ff: int = 83640
    bram: int = 208
    dsp: int = 156


DEVICES = {
    "um5g-85k": Device("LFE5UM5G-85F-8BG381", ("--um5g-85k", "--package", "CABGA381", "--speed", "8")),
    "85k": Device("LFE5U-85F-6BG381", ("--85k", "--package", "CABGA381", "--speed", "6")),
}
"""The parts with 84,000 LUTs, by the names that the command line takes. The first, the default, is the fastest of them."""


class Steps:
    """The steps of a build in a folder, and the seconds that each took when it was last done."""

    def __init__(self, folder: Path, *, keep: bool = True):
        self.folder, self._keep, self.seconds = folder, keep, {}

    def __call__(
        self, name: str, what: str, made_of: Sequence[object], results: Sequence[Path], do: Callable[[], None],
    ) -> bool:
        """Does a step unless its results are there and were made of the same. Returns whether it was done now.

        Args:
            name: the step.
            what: what the terminal shows meanwhile.
            made_of: what the results depend on: files, whose contents count, and values.
            results: the files that the step makes.
            do: makes them.
        """
        stamp, state = self.folder / f"{name}.done.json", hashlib.sha256()
        for part in made_of:
            state.update(part.read_bytes() if isinstance(part, Path) else repr(part).encode())
        digest = state.hexdigest()
        old = read_json(stamp) if stamp.is_file() else {}
        if self._keep and old.get("made_of") == digest and all(path.is_file() for path in results):
            self.seconds[name] = old["seconds"]
            print(f"{what}: kept, it took {old['seconds']:.0f} s", flush=True)
            return False
        stamp.unlink(missing_ok=True)
        begin = time.monotonic()
        with phase(what):
            do()
        self.seconds[name] = round(time.monotonic() - begin, 1)
        write_json(stamp, {"made_of": digest, "seconds": self.seconds[name]})
        print(f"{what}: {self.seconds[name]:.0f} s", flush=True)
        return True


def firmware(steps: Steps) -> list[int]:
    """The words of the firmware, compiled for the processor. Raises InputError where they do not fit its RAM."""
    elf, binary = steps.folder / "firmware.elf", steps.folder / "firmware.bin"
    options = [
        "-target", "riscv32-freestanding-none", "-mcpu=generic_rv32", "-mabi=ilp32", "-Os", *_WARNINGS, "-ffreestanding",
        "-static", f"-DCLOCK_KHZ={1000 * CLOCK_MHZ}u", f"-I{DOCS}", f"-I{DRIVER}", "-T", SOURCES / "firmware.ld",
        "-Wl,--entry=start", "-Wl,--gc-sections", "-ffunction-sections"]

    def compile_() -> None:
        tools.run(tools.zig("cc", *options, *_FIRMWARE_SOURCES, "-o", elf), steps.folder / "firmware.log")
        tools.run(tools.zig("objcopy", "-O", "binary", elf, binary), steps.folder / "objcopy.log")

    made_of = [*_FIRMWARE_SOURCES, *_FIRMWARE_OTHERS, [str(option) for option in options], tools.versions()["ziglang"]]
    steps("firmware", "compiling the firmware", made_of, [elf, binary], compile_)
    data = binary.read_bytes()
    if not 0 < len(data) <= 4 * FIRMWARE_WORDS:
        raise InputError(f"the firmware has {len(data)} bytes: 1 to {4 * FIRMWARE_WORDS} are accepted")
    data += bytes(-len(data) % 4)
    return [int.from_bytes(data[place : place + 4], "little") for place in range(0, len(data), 4)]


def rtlil(config: AcceleratorConfig, words: Sequence[int], folder: Path) -> Path:
    """The system in Yosys' own language, with the firmware in its RAM."""
    path = folder / f"{TOP}.il"
    path.write_text(to_rtlil(System(config, words, DIVISOR), TOP))
    return path


def synthesise(steps: Steps, source: Path) -> dict[str, int]:
    """Maps the system to cells of the family, and returns their numbers by type.

    Every memory of more than SHALLOW words that is read with a clock is put into blocks. LUTs hold the shallow ones, and those
    that are read without a clock: the banks of pixels. ABC is told a time, so that it saves area and not delay where there is
    some left, and builds no wide LUTs, whose parts have to be placed together.
    """
    processor, netlist, cells = tools.processor_verilog(), steps.folder / "netlist.json", steps.folder / "cells.json"
    family = f"synth_lattice -family ecp5 -nowidelut -top {TOP} -json {netlist}"
    script = [
        *COMMANDS, f"scratchpad -set abc9.D {LOGIC_PS}", f"{family} -run begin:map_ram",
        f"setattr -set ram_style \"block\" t:$mem_v2 r:RD_CLK_ENABLE=1'1 %i r:SIZE>{SHALLOW} %i",
        f"{family} -run map_ram:", f"tee -q -o {cells} stat -top {TOP} -json"]

    def map_() -> None:
        log = steps.folder / "synthesis.log"
        log.unlink(missing_ok=True)
        yosys.run(f"read_rtlil {source}", f"read_verilog {processor}", f"hierarchy -top {TOP}", *script, log=log)

    steps("synthesis", "synthesising", [source, processor, script, yosys.version()], [netlist, cells], map_)
    return dict(json.loads(cells.read_text())["modules"][f"\\{TOP}"]["num_cells_by_type"])


def place(steps: Steps, device: Device, seed: int) -> Path:
    """Places the netlist, and returns nextpnr's file of the placed one. Raises InputError where it does not fit.

    nextpnr's default placer makes wires 1.4 times as long on this netlist.
    """
    netlist, placed = steps.folder / "netlist.json", steps.folder / "placed.json"
    options = [*device.options, *_CLOCK, "--seed", seed, "--placer", "static", "--no-route"]
    command = tools.nextpnr(*options, "--json", netlist.name, "--write", placed.name)
    steps("place", "placing", [netlist, [str(word) for word in options], tools.versions()], [placed],
          lambda: tools.run(command, steps.folder / "place.log", steps.folder))
    return placed


def route(steps: Steps, device: Device, placed: Path) -> dict[str, Any]:
    """Routes the placed netlist, and returns nextpnr's own report. Raises InputError where the router gives up."""
    routable, report, text = (steps.folder / name for name in ("routable.json", "nextpnr.json", "routed.config"))
    options = [*device.options, *_CLOCK, "--no-pack", "--no-place"]

    def route_() -> None:
        design = json.loads(placed.read_text())
        for module in design["modules"].values():
            module["settings"] |= ROUTER
        routable.write_text(json.dumps(design))
        command = tools.nextpnr(*options, "--json", routable.name, "--textcfg", text.name, "--report", report.name)
        tools.run(command, steps.folder / "route.log", steps.folder)

    steps("route", "routing", [placed, ROUTER, [str(word) for word in options], tools.versions()], [text, report], route_)
    return dict(read_json(report))


def pack(steps: Steps) -> Path:
    """Writes the bitstream."""
    routed, bits = steps.folder / "routed.config", steps.folder / "msv2.bit"
    steps("pack", "writing the bitstream", [routed, tools.versions()], [bits],
          lambda: tools.run(
              tools.ecppack("--input", routed.name, "--bit", bits.name), steps.folder / "ecppack.log", steps.folder))
    return bits


def counted(cells: dict[str, int], device: Device) -> dict[str, object]:
    """What the netlist takes by kind, what the part has, and whether it is enough."""
    used = FAMILIES["ecp5"].count(cells)
    taken = {"lut": used["lut"] + used["lut_ram"], "ff": used["ff"], "bram": used["bram"], "dsp": used["dsp"]}
    has = {kind: getattr(device, kind) for kind in taken}
    return {"used": taken, "of": has, "enough": all(taken[kind] <= has[kind] for kind in taken)}


def routed_report(found: dict[str, Any], bits: Path) -> dict[str, object]:
    """What nextpnr found: the clock, what is used by kind of cell, and whether all of it has a place."""
    clocks, used = found["fmax"], found["utilization"]
    return {
        "fits": all(kind["used"] <= kind["available"] for kind in used.values()),
        "fmax_mhz": round(min(clock["achieved"] for clock in clocks.values()), 2),
        "utilization": used, "bitstream_bytes": bits.stat().st_size}
