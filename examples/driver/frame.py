"""Frames by the C driver: exports a machine, builds it with Verilator around the driver, renders frames, compares.

    python examples/driver/frame.py
    python examples/driver/frame.py --config tiny_v3 --frames 3
    python examples/driver/frame.py --config tiny_v3_packed     # packed frames, which the driver's unpacker unpacks
    python examples/driver/frame.py --config tiny_eyes          # joint frames of two eyes; tiny_eyes_packed packs them

The first run of a machine builds its simulator, which takes minutes; later ones take seconds. Frames follow each other without
a reset, seen by one camera after the other, and machines with lists by super-tile keep what they have learnt from the frame
before. Every picture is compared with the golden renderer's in every bit, and the counters that the driver reads with its
counts. Exit status 1 where any differs.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import re
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from frame_image import write_frame_image

from golden.host.memory_image import DisplayPixels, MemoryImage
from golden.msv2_ref.batches import following
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.pictures import save_png
from golden.scenes.request import make_folder
from golden.scenes.stereo import stereo_pair
from msv2.verilog.export import export
from spec.config import TINY, TINY_EYES, TINY_V3, AcceleratorConfig
from spec.errors import InputError, run_command_line
from spec.memory import DISPLAY_PIXEL_BYTES
from spec.paths import DOCS
from tb.common.runner import VERILATOR, check_tools, verilator_environment
from tb.frame.whole import picture
from tb.top.check import differences, mismatches
from tb.top.check_joint import joint_events
from tb.top.plan_joint import after
from tb.top.stimuli import Case

HERE = Path(__file__).resolve().parent
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wstrict-prototypes", "-Werror", "-O2")
C_SOURCES = ("msv2_driver.c", "msv2_packed.c", "demo.c")
MACHINES = {config.name: config for config in (
    TINY, TINY_V3, TINY_V3.with_(name="tiny_v3_packed", packed=True), TINY_EYES,
    TINY_EYES.with_(name="tiny_eyes_packed", packed=True))}
CAMERAS = 8
"""Cameras of the embedded scene's orbit."""

ADDRESS, TIMEOUT = 0x40000, 10000
"""Where an image lies in the simulated memory: not at 0, so that a base that is not moved changes the frame. Milliseconds for a
frame."""


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


def build(config: AcceleratorConfig, folder: Path) -> Path:
    """The simulator of a machine with driver and demo, built where a source has changed."""
    check_tools()
    machine = export(config, folder / "verilog")
    simulator, stamp, log = folder / "model" / "simulation", folder / "built", folder / "build.log"
    headers = ("msv2_driver.h", "msv2_packed.h", "demo.h")
    sources = [*(HERE / name for name in (*headers, *C_SOURCES, "simulation.cpp")), DOCS / "msv2_registers.h",
               *sorted((folder / "verilog").rglob("*.v"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    if simulator.is_file() and stamp.is_file() and stamp.read_text() == digest:
        return simulator
    log.unlink(missing_ok=True)
    for name in C_SOURCES:
        run(["gcc", *WARNINGS, "-I", HERE, "-I", DOCS, "-c", HERE / name, "-o", folder / f"{name}.o"], folder, log)
    apart = folder / "apart.vlt"  # pixel cores that are not inlined compile faster
    core = "batch_core" if config.supertiles else "pixel_core"
    apart.write_text(f'`verilator_config\nno_inline -module "{config.name}_{core}"\n')
    print(f"building the simulator of the machine {config.name}: minutes", flush=True)
    run([VERILATOR, "--cc", "--exe", "--build", "-j", os.cpu_count() or 1, "-O3", "--x-assign", "fast", "--x-initial", "fast",
         "-Wno-fatal", "--top-module", machine.top, "--prefix", "Vmachine", "--Mdir", simulator.parent, "-o", simulator.name,
         "-CFLAGS", f"-I{HERE} -I{DOCS}", "-LDFLAGS", " ".join(str(folder / f"{name}.o") for name in C_SOURCES),
         machine.waivers.resolve(), apart, "-F", machine.files.resolve(), HERE / "simulation.cpp"], folder, log)
    stamp.write_text(digest)
    return simulator


def golden_frames(config: AcceleratorConfig, size: int, count: int) -> list[Frame | JointFrame]:
    """Square frames of the embedded scene from its cameras in turn, as a machine renders them one after the other: joint frames
    of both eyes on a machine that has them."""
    model, cameras = cached_embedded_model(), embedded_cameras(size, size)
    frames: list[Frame | JointFrame] = []
    for number in range(count):
        camera = cameras[number % CAMERAS]
        if config.joint:
            case = Case("", render_joint(model, stereo_pair(camera), config=config), None, False)
            frames.append(after(case, replace(case, frame=frames[-1])).frame if frames else case.frame)
        else:
            frame = render(model, camera, config=config)
            frames.append(following(frame, frames[-1], None) if config.supertiles and frames else frame)
    return frames


def wrong_counts(frame: Frame | JointFrame, said: str) -> list[str]:
    """The counters that the driver has printed for a frame and that differ from the golden frame's counts."""
    found = {name: int(value) for name, value in re.findall(r"(\w+) (\d+)", said.partition("\n")[2])}
    events = (joint_events(frame) if isinstance(frame, JointFrame) else expected_events(frame)) | {"frames": 1}
    return [f"counter {name} must be {events[name]}, not {count}" for name, count in found.items()
            if events.get(name, count) != count]


def unpacked(image: MemoryImage, path: Path, eyes: int) -> list[DisplayPixels]:
    """The pixels that the driver's unpacker made of a packed frame of so many eyes, which follow it in the file."""
    pixels = eyes * image.width * image.height * DISPLAY_PIXEL_BYTES
    data = np.fromfile(path, np.uint8)[-pixels:].reshape(eyes, image.height, image.width, DISPLAY_PIXEL_BYTES).astype(np.int64)
    return [DisplayPixels(eye[..., :3], eye[..., 3]) for eye in data]


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", choices=MACHINES, default=TINY.name, help=f"the machine (default: {TINY.name})")
    parser.add_argument("--out", type=Path, default=Path("build/examples/driver"), metavar="DIR",
                        help="a folder for all machines, each in a folder of its name (default: build/examples/driver)")
    parser.add_argument("--size", type=int, default=48, metavar="PIXELS", help="width and height of a frame (default: 48)")
    parser.add_argument("--frames", type=int, default=1, metavar="N", help="frames in a row, 1 to 8 (default: 1)")
    args = parser.parse_args(argv)
    config = MACHINES[args.config]
    if not 1 <= args.size <= config.row_width:
        raise InputError(f"size {args.size} is not accepted: 1 to {config.row_width} pixels are")
    if not 1 <= args.frames <= CAMERAS:
        raise InputError(f"frames {args.frames} is not accepted: 1 to {CAMERAS} are")
    out = args.out.resolve() / config.name
    make_folder(out)
    with open(out / "lock", "w") as lock:  # a second run would build into the same folder, so it waits
        fcntl.flock(lock, fcntl.LOCK_EX)
        return rendered(build(config, out), config, out, args.size, args.frames)


def rendered(simulator: Path, config: AcceleratorConfig, out: Path, size: int, count: int) -> int:
    """Renders square frames of `size` pixels by the driver and compares them; returns 1 where anything differs."""
    frames = golden_frames(config, size, count)
    images = [write_frame_image(frame, out / f"frame{number}.img") for number, frame in enumerate(frames)]
    files = [out / f"frame{number}.{kind}" for number in range(count) for kind in ("img", "bin")]
    done = subprocess.run([simulator, hex(ADDRESS), str(TIMEOUT), *files], check=False, capture_output=True, text=True)
    print(done.stdout, end="")
    if done.returncode:
        print(f"FAIL: the simulation ends with status {done.returncode}: {done.stderr}")
        return 1
    wrong = 0
    for number, (frame, image, said) in enumerate(zip(frames, images, done.stdout.split("machine ")[1:], strict=True)):
        path, counts = out / f"frame{number}.bin", wrong_counts(frame, said)
        eyes = frame.eyes if isinstance(frame, JointFrame) else (frame,)
        found = [image.frame(path), image.target_frame(path)][: len(eyes)]
        for eye, pixels, name in zip(eyes, found, ("", "_target"), strict=False):
            save_png(out / f"frame{number}{name}.png", picture(eye, pixels))
        values = [wrong for eye, pixels in zip(eyes, found, strict=True) for wrong in mismatches(eye, pixels)]
        if image.packed:
            values += [wrong for eye, pixels in zip(eyes, unpacked(image, path, len(eyes)), strict=True)
                       for wrong in differences(display_pixels(eye), pixels)]
        for line in counts:
            print(line)
        lists = f", {frame.bounds.lists} lists" if frame.bounds else ""
        both = " for each of two eyes" if len(eyes) > 1 else ""
        count = sum(len(eye.entries.splat) for eye in eyes)
        print(f"frame {number}: {size}x{size} pixels{both}, {count} intersections{lists}, {len(values)} values differ "
              "from the golden frame")
        wrong += bool(values or counts)
    return int(wrong > 0)


if __name__ == "__main__":
    run_command_line(main)
