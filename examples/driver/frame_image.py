"""Writes a frame image: all that the C driver needs for a frame, in one file that it uses as it lies in memory.

    python examples/driver/frame_image.py --size 64x64 --out build/driver/frame.img
    python examples/driver/frame_image.py truck.splat --config paper --size 640x360 --gaze 320,180 --levels 4 --out truck.img
    python examples/driver/frame_image.py --config v3 --read build/driver/frame.img

The last command tells what an image holds, and whether it fits a machine. spec/images.py has the format. The file fits one
machine: its head has the format of its records and that machine's fingerprint.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from golden.host.image_file import image_bytes, read_image
from golden.host.memory_image import MemoryImage
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.files import atomic_output
from golden.scenes.request import add_request_arguments, resolve
from spec.command_line import add_out_argument, command_parser
from spec.config import AcceleratorConfig
from spec.errors import InputError, run_command_line
from spec.images import RECORD_FORMATS
from spec.memory import BEAT_BYTES
from spec.overrides import add_config_arguments, config_from
from tb.top.check import frame_run
from tb.top.check_joint import joint_run
from tb.top.player import Map, setting_writes

DEFAULT_OUT = Path("build/driver/frame.img")


def frame_image_bytes(image: MemoryImage) -> bytes:
    """The file's contents for a frame's memory image."""
    registers = Map(image.config)
    return image_bytes(
        image, {registers[name]: value for name, value in setting_writes(image.config, image, {}).items()})


def write_frame_image(frame: Frame | JointFrame, path: Path) -> MemoryImage:
    """Writes the image of a golden frame for displays, of one eye or of both (`spec.joint`), with exactly as much memory as it
    needs, and returns it. The frame of a machine that packs frames is packed.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    run = joint_run if isinstance(frame, JointFrame) else frame_run
    image = run(frame, None, display=True, packed=frame.config.packed).image
    with atomic_output(path) as file:
        file.write(frame_image_bytes(image))
    return image


def tell(name: str, config: AcceleratorConfig) -> None:
    """Prints what an image holds.

    Raises:
        InputError: the file cannot be read, or its image does not fit the machine.
    """
    try:
        data = Path(name).read_bytes()
    except OSError as error:
        raise InputError(f"image {name} is not accepted: {error.strerror}") from error
    head = read_image(config, data, f"image {name}").head
    print(f"{name}: {head['width']}x{head['height']} pixels, {RECORD_FORMATS[head['records']]}, {head['settings']} settings, "
          f"{head['memory']:,} bytes of memory")


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = command_parser("python examples/driver/frame_image.py", __doc__)
    add_request_arguments(parser, size="64x64")
    add_config_arguments(parser, "tiny")
    add_out_argument(parser, str(DEFAULT_OUT))
    parser.add_argument("--read", metavar="FILE", help="tell what an image holds, instead of writing one")
    args = parser.parse_args(argv)
    if args.read:
        tell(args.read, config_from(args, "tiny"))
        return 0
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
