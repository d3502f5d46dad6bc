"""The system of `msv2 fpga` in Verilator: its firmware renders a frame, whose pixels are compared with the golden renderer's.

The simulated design is the one that is placed and routed, with the same firmware in its RAM. Only what is outside the FPGA is a
model: main memory, and the other end of the serial line (examples/fpga/simulation.cpp).
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from golden.host.image_file import image_bytes
from golden.host.memory_image import MemoryImage
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.files import atomic_output
from golden.scenes.pictures import save_png
from msv2.fpga import tools
from msv2.fpga.flow import DIVISOR, SOURCES, TOP, Steps
from rtl.emit import verilog_of
from spec.config import AcceleratorConfig
from spec.errors import InputError
from spec.memory import BEAT_BYTES
from tb.common.runner import VERILATOR, check_tools, verilator_environment
from tb.frame.whole import picture
from tb.top.check import frame_run, mismatches
from tb.top.player import Map, setting_writes

IMAGE, DRAM = 0x01000000, 0x40000
"""Where the frame image lies, and where the frame's memory begins: IMAGE and DRAM of examples/fpga/firmware.c."""

SIZE, CAMERA, COUNT, SH_DEGREE = 64, 0, 4000, 1
"""The frame: its width and height in pixels, the camera, and how fine the embedded scene is. The processor copies the model
itself, which takes most of the simulated cycles, so the scene has a fifth of its usual points."""
MOST_CYCLES = 100_000_000

_SIMULATION = SOURCES / "simulation.cpp"


def golden_frame(config: AcceleratorConfig, size: int = SIZE) -> Frame:
    """A square frame of the embedded scene by the golden renderer."""
    return render(cached_embedded_model(COUNT, sh_degree=SH_DEGREE), embedded_cameras(size, size)[CAMERA], config=config)


def build(steps: Steps, source: Path) -> Path:
    """The simulator of the system, built where the system or the model around it has changed."""
    check_tools()
    folder, verilog, processor = steps.folder / "model", steps.folder / f"{TOP}.v", tools.processor_verilog()
    simulator, log = folder / "simulation", steps.folder / "verilator.log"
    apart = steps.folder / "apart.vlt"
    options = ["-O3", "--x-assign", "fast", "--x-initial", "fast", "--no-timing", "-Wno-fatal", "-Wno-lint"]

    def build_() -> None:
        verilog.write_text("`timescale 1ns / 1ps\n" + verilog_of(source.read_text()))
        # Modules that are many and not inlined compile faster.
        apart.write_text('`verilator_config\nno_inline -module "memory_core"\nno_inline -module "picorv32"\n')
        with open(log, "w") as file:
            done = subprocess.run(
                [str(word) for word in (
                    VERILATOR, "--cc", "--exe", "--build", "-j", 1, *options, "--top-module", TOP, "--prefix", f"V{TOP}",
                    "--Mdir", folder.resolve(), "-o", simulator.name, apart.resolve(), verilog.resolve(), processor,
                    _SIMULATION)],
                check=False, stdout=file, stderr=subprocess.STDOUT, env=os.environ | verilator_environment())
        if done.returncode:
            end = "\n".join(log.read_text().splitlines()[-20:])
            raise InputError(f"Verilator failed; the end of {log}:\n{end}")

    steps("simulator", "building the simulator of the system", [source, processor, _SIMULATION, options], [simulator], build_)
    return simulator


def image_of(frame: Frame, path: Path) -> MemoryImage:
    """Writes the frame image that the firmware's driver reads, and returns the memory image."""
    image = frame_run(frame, None, display=True).image
    registers = Map(image.config)
    with atomic_output(path) as file:
        file.write(image_bytes(
            image, {registers[name]: value for name, value in setting_writes(image.config, image, {}).items()}))
    return image


def said(text: str) -> dict[str, int]:
    """The numbers that the firmware said over the serial line, and those that the simulation printed."""
    numbers = {name: int(value, 16) for name, value in re.findall(r"^(\w+) 0x([0-9a-f]{8})$", text, re.MULTILINE)}
    end = re.search(r"^status (\d+) cycles (\d+)$", text, re.MULTILINE)
    return numbers | ({"status": int(end[1]), "simulated_cycles": int(end[2])} if end else {})


def simulate(steps: Steps, config: AcceleratorConfig, source: Path, size: int = SIZE) -> dict[str, object]:
    """Renders a frame by the system in Verilator, writes it as soc.png, and says what was found."""
    simulator = build(steps, source)
    frame = golden_frame(config, size)
    folder = steps.folder
    image = image_of(frame, folder / "soc.img")
    output, log = folder / "soc.bin", folder / "soc.log"
    at = DRAM + BEAT_BYTES * image.regions["frame"].base
    size_bytes = image.width * image.height * image.pixel_bytes
    command: Sequence[object] = (
        simulator, hex(IMAGE), hex(at), size_bytes, DIVISOR, MOST_CYCLES, folder / "soc.img", output)

    def run_() -> None:
        with open(log, "w") as file:
            done = subprocess.run([str(word) for word in command], check=False, stdout=file, stderr=subprocess.STDOUT)
        if done.returncode not in (0, 1, 2):
            raise InputError(f"the simulation ended with status {done.returncode}; see {log}")

    steps("soc", "simulating the system", [simulator, folder / "soc.img", size_bytes], [output, log], run_)
    numbers = said(log.read_text())
    values = mismatches(frame, image.frame(output))
    save_png(folder / "soc.png", picture(frame, image.frame(output)))
    for line in values[:5]:
        print(line)
    return {
        "size": [size, size], "intersections": len(frame.entries.splat), "driver": "firmware in C on a RISC-V core (PicoRV32)",
        "numbers": numbers, "wrong_values": len(values),
        "bit_exact": not values and numbers.get("status") == 2}
