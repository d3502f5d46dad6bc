"""One frame by the C driver: exports the machine, builds it with Verilator around the driver, renders a frame, compares.

    python examples/driver/frame.py --out build/examples/driver

The first run builds a simulator of the tiny machine, which takes minutes; later ones take seconds. The picture is compared with
the golden renderer's in every bit, and the counters that the driver reads with its counts. Exit status 1 where any differs.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from frame_image import write_frame_image

from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.pictures import save_png
from golden.scenes.request import make_folder
from msv2.verilog.export import export
from spec.config import TINY
from spec.errors import InputError, run_command_line
from spec.paths import DOCS
from tb.common.runner import VERILATOR, check_tools, verilator_environment
from tb.frame.whole import picture
from tb.top.check import expected_events, mismatches

HERE = Path(__file__).resolve().parent
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wstrict-prototypes", "-Werror", "-O2")
C_SOURCES = ("msv2_driver.c", "demo.c")
ADDRESS = 0x40000
"""Where the image lies in the simulated memory: not at 0, so that a base that is not moved changes the frame."""


def run(command: Sequence[object], folder: Path, log: Path) -> None:
    """Runs a command of the build. Raises InputError with the end of its output where it fails."""
    environment = os.environ | verilator_environment()
    done = subprocess.run([str(word) for word in command], cwd=folder, env=environment, check=False, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    with log.open("a") as file:
        file.write(done.stdout)
    if done.returncode:
        end = "\n".join(done.stdout.splitlines()[-20:])
        raise InputError(f"{Path(str(command[0])).name} failed; the end of {log}:\n{end}")


def build(folder: Path) -> Path:
    """The simulator of the tiny machine with driver and demo, built where a source has changed."""
    check_tools()
    machine = export(TINY, folder / "verilog")
    simulator, stamp, log = folder / "model" / "simulation", folder / "built", folder / "build.log"
    sources = [*(HERE / name for name in ("msv2_driver.h", "demo.h", *C_SOURCES, "simulation.cpp")), DOCS / "msv2_registers.h",
               *sorted((folder / "verilog").rglob("*.v"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    if simulator.is_file() and stamp.is_file() and stamp.read_text() == digest:
        return simulator
    log.unlink(missing_ok=True)
    for name in C_SOURCES:
        run(["gcc", *WARNINGS, "-I", HERE, "-I", DOCS, "-c", HERE / name, "-o", folder / f"{name}.o"], folder, log)
    apart = folder / "apart.vlt"  # pixel cores that are not inlined compile faster
    apart.write_text('`verilator_config\nno_inline -module "tiny_pixel_core"\n')
    print("building the simulator of the tiny machine: minutes", flush=True)
    run([VERILATOR, "--cc", "--exe", "--build", "-j", os.cpu_count() or 1, "-O3", "--x-assign", "fast", "--x-initial", "fast",
         "-Wno-fatal", "--top-module", machine.top, "--prefix", "Vmachine", "--Mdir", simulator.parent, "-o", simulator.name,
         "-CFLAGS", f"-I{HERE} -I{DOCS}", "-LDFLAGS", " ".join(str(folder / f"{name}.o") for name in C_SOURCES),
         machine.waivers.resolve(), apart, "-F", machine.files.resolve(), HERE / "simulation.cpp"], folder, log)
    stamp.write_text(digest)
    return simulator


def wrong_counts(frame: Frame, said: str) -> list[str]:
    """The counters that the driver has printed and that differ from the golden frame's counts."""
    found = {name: int(value) for name, value in re.findall(r"(\w+) (\d+)", said.partition("\n")[2])}
    events = expected_events(frame) | {"frames": 1}
    return [f"counter {name} must be {events[name]}, not {count}" for name, count in found.items()
            if events.get(name, count) != count]


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/examples/driver"), metavar="DIR")
    parser.add_argument("--size", type=int, default=48, metavar="PIXELS", help="width and height of the frame (default: 48)")
    args = parser.parse_args(argv)
    if not 1 <= args.size <= TINY.row_width:
        raise InputError(f"size {args.size} is not accepted: 1 to {TINY.row_width} pixels are")
    out = args.out.resolve()
    make_folder(out)
    with open(out / "lock", "w") as lock:  # a second run would build into the same folder, so it waits
        fcntl.flock(lock, fcntl.LOCK_EX)
        return rendered(build(out), out, args.size)


def rendered(simulator: Path, out: Path, size: int) -> int:
    """Renders a square frame of `size` pixels by the driver and compares it; returns 1 where anything differs."""
    golden = render(cached_embedded_model(), embedded_cameras(size, size)[0], config=TINY)
    image = write_frame_image(golden, out / "frame.img")
    done = subprocess.run([simulator, out / "frame.img", out / "frame.bin", hex(ADDRESS)], check=False, capture_output=True,
                          text=True)
    print(done.stdout, end="")
    if done.returncode:
        print(f"FAIL: the simulation ends with status {done.returncode}: {done.stderr}")
        return 1
    pixels = image.frame(out / "frame.bin")
    save_png(out / "frame.png", picture(golden, pixels))
    counts, values = wrong_counts(golden, done.stdout), mismatches(golden, pixels)
    for line in counts:
        print(line)
    print(f"{size}x{size} pixels, {len(golden.entries.splat)} intersections, "
          f"{len(values)} values differ from the golden frame")
    return 1 if values or counts else 0


if __name__ == "__main__":
    run_command_line(main)
