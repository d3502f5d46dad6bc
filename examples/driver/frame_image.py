"""Writes a frame image: all that the C driver needs for a frame, in one file that it uses as it lies in memory.

    python examples/driver/frame_image.py --size 64x64 --out build/driver/frame.img
    python examples/driver/frame_image.py truck.splat --config paper --size 640x360 --gaze 320,180 --levels 4 --out truck.img

The file holds little-endian words of 32 bits: a head of ten words, the settings (offset and value of each register), a table of
segments (address, bytes, place in the file), and the contents. msv2_driver.c explains the head. Addresses count from 0; the
driver adds the address at which the image lies in memory. The file fits one machine: its head has that machine's fingerprint.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.host.memory_image import MemoryImage
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.files import atomic_output
from golden.scenes.request import add_request_arguments, resolve
from spec.command_line import add_out_argument, command_parser
from spec.errors import run_command_line
from spec.memory import BEAT_BYTES
from spec.overrides import add_config_arguments, config_from
from spec.registers import fingerprint
from tb.top.check import frame_run
from tb.top.player import Map, setting_writes

MAGIC, VERSION = 0x3249534D, 2
DEFAULT_OUT = Path("build/driver/frame.img")


def image_bytes(image: MemoryImage) -> bytes:
    """The file's contents for a frame's memory image."""
    registers = Map(image.config)
    settings = [(registers[name], value) for name, value in setting_writes(image.config, image, {}).items()]
    segments = {name: rows for name, rows in image.contents.items() if len(rows)}
    head = [MAGIC, VERSION, fingerprint(image.config), len(settings), len(segments), image.width, image.height,
            image.pixel_bytes, BEAT_BYTES * image.regions["frame"].base, BEAT_BYTES * image.beats]
    place, table = 4 * (len(head) + 2 * len(settings) + 3 * len(segments)), []
    for name, rows in segments.items():
        table += [BEAT_BYTES * image.regions[name].base, rows.nbytes, place]
        place += rows.nbytes
    words = np.array([*head, *(word for pair in settings for word in pair), *table], "<u4")
    return words.tobytes() + b"".join(rows.tobytes() for rows in segments.values())


def write_frame_image(frame: Frame, path: Path) -> MemoryImage:
    """Writes the image of a golden frame for displays, with exactly as much memory as it needs, and returns it.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    image = frame_run(frame, None, display=True).image
    with atomic_output(path) as file:
        file.write(image_bytes(image))
    return image


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = command_parser("python examples/driver/frame_image.py", __doc__)
    add_request_arguments(parser, size="64x64")
    add_config_arguments(parser, "tiny")
    add_out_argument(parser, str(DEFAULT_OUT))
    args = parser.parse_args(argv)
    request, out = resolve(args), Path(args.out or DEFAULT_OUT)
    frame = render(request.model, request.camera, config=config_from(args, "tiny"), foveation=request.foveation,
                   background=request.background)
    out.parent.mkdir(parents=True, exist_ok=True)
    image = write_frame_image(frame, out)
    print(f"{out}: {image.width}x{image.height} pixels, {image.settings['gaussians']:,} Gaussians, "
          f"{out.stat().st_size:,} bytes, {BEAT_BYTES * image.beats:,} bytes of memory")
    return 0


if __name__ == "__main__":
    run_command_line(main)
