"""One frame through the accelerator in someone else's system: exports it, simulates `system.v` with Icarus Verilog, compares.

    python examples/axi_system/frame.py --out build/examples/axi_system

The frame is a small one, since Icarus runs a few hundred cycles of the machine a second. Exit status 1 where a pixel differs
from the golden renderer's.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.host.memory_image import MemoryImage
from golden.msv2_ref import pipeline
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras
from msv2.verilog.export import export
from spec.config import TINY
from spec.errors import InputError, run_command_line
from spec.private import output_folder
from tb.top.check import frame_run, mismatches
from tb.top.player import Map, setting_writes

HERE = Path(__file__).resolve().parent
SIZE = 32
POINTS = 60
BURST = 4
"""Beats of a burst of the testbench's DMA engine."""


def write_image(image: MemoryImage, path: Path) -> None:
    """The regions that the host fills, as hexadecimal beats; what else lies in their bursts is 0."""
    filled: dict[int, str] = {}
    for name, contents in image.contents.items():
        for place, beat in enumerate(contents, image.regions[name].base):
            filled[place] = beat[::-1].tobytes().hex()
    for first in {place // BURST * BURST for place in filled}:
        filled |= {place: "0" for place in range(first, first + BURST) if place not in filled}
    path.write_text("".join(f"@{place:x} {filled[place]}\n" for place in sorted(filled)))


def write_registers(image: MemoryImage, path: Path) -> int:
    """Addresses and values of all settings, and the start with the interrupt enabled; returns how many."""
    registers = Map(TINY)
    writes = [(registers[name], value) for name, value in setting_writes(TINY, image, {}).items()]
    writes.append(registers.value("control", start=1, enable_done=1, enable_error=1))
    path.write_text("".join(f"{address:08x}{value:08x}\n" for address, value in writes))
    return len(writes)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: build/examples/axi_system)")
    with output_folder(parser.parse_args(argv).out, Path("build/examples/axi_system")) as out:
        return _run(out)


def _run(out: Path) -> int:
    """Simulates the frame with all files in the folder `out`; 1 where a value differs."""
    if shutil.which("iverilog") is None:
        raise InputError("iverilog is not installed: apt-get install iverilog")
    machine = export(TINY, out)

    model = cached_embedded_model()
    model = model.select(np.linspace(0, len(model) - 1, POINTS).astype(np.int64))
    golden = pipeline.render(model, embedded_cameras(SIZE, SIZE)[0], config=TINY)
    image = frame_run(golden, None).image
    write_image(image, out / "image.hex")
    parameters = {"BEATS": 1 << (image.beats + BURST).bit_length(), "WRITES": write_registers(image, out / "writes.hex"),
                  "FRAME_BASE": image.regions["frame"].base, "FRAME_BEATS": image.regions["frame"].beats}

    sources = [str(HERE / name) for name in ("testbench.v", "system.v", "axi_interconnect.v", "axi_memory.v")]
    settings = [f"-Ptestbench.{name}={value}" for name, value in parameters.items()]
    subprocess.run(["iverilog", "-g2005", "-o", "system.vvp", "-s", "testbench", *settings, "-f", machine.files.name, *sources],
                   cwd=out, check=True)
    said = subprocess.run(["vvp", "-n", "system.vvp"], cwd=out, check=True, capture_output=True, text=True).stdout
    print(said, end="")
    beats = (out / "frame.hex").read_text().split()
    if "FAIL" in said or any("x" in beat for beat in beats):
        print("FAIL: the frame has unknown bits, or the testbench met an error")
        return 1
    (out / "frame.bin").write_bytes(b"".join(bytes.fromhex(beat)[::-1] for beat in beats))
    wrong = mismatches(golden, image.frame(out / "frame.bin"))
    print(f"{SIZE * SIZE} pixels, {len(golden.entries.splat)} intersections, {len(wrong)} values differ from the golden frame")
    return 1 if wrong else 0


if __name__ == "__main__":
    run_command_line(main)
