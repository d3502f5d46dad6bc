"""Writes pictures as a film: GIF and WebP by Pillow, MP4 by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from golden.scenes.files import atomic_output
from spec.command_line import choice
from spec.errors import InputError

FORMATS = ("webp", "gif", "mp4")
FFMPEG = "ffmpeg"


def parse_formats(text: str | None) -> tuple[str, ...]:
    """The formats in a list separated by commas; None for WebP, and MP4 where ffmpeg is found.

    Raises:
        InputError: a format is unknown, or MP4 is asked for without ffmpeg.
    """
    if text is None:
        return ("webp", "mp4") if shutil.which(FFMPEG) else ("webp",)
    formats = tuple(dict.fromkeys(choice("film format", name.strip().lower(), FORMATS) for name in text.split(",")))
    if "mp4" in formats and not shutil.which(FFMPEG):
        raise InputError("film format 'mp4' needs ffmpeg, which was not found: apt install ffmpeg, or choose webp or gif")
    return formats


def write_film(path: Path, pictures: Sequence[Path], fps: float, quality: int) -> None:
    """Writes the pictures, which have equal sizes, as a film of the format that `path` is named after.

    GIF and WebP repeat for ever. A GIF has at most 256 colours a frame and its frames last whole hundredths of a second.

    Args:
        path: where; the film appears complete or not at all.
        pictures: PNG files in order.
        fps: frames a second.
        quality: of WebP, 1..100.

    Raises:
        InputError: ffmpeg refuses the pictures.
    """
    if path.suffix == ".mp4":
        _write_mp4(path, pictures, fps)
        return
    frames = [Image.open(picture).convert("RGB") for picture in pictures]
    if path.suffix == ".gif":
        frames = [frame.quantize(256, dither=Image.Dither.FLOYDSTEINBERG) for frame in frames]
    options = {"quality": quality, "method": 4} if path.suffix == ".webp" else {"optimize": True}
    with atomic_output(path) as file:
        frames[0].save(file, format=path.suffix[1:].upper(), save_all=True, append_images=frames[1:], loop=0,
                       duration=round(1000 / fps), **options)


def _write_mp4(path: Path, pictures: Sequence[Path], fps: float) -> None:
    """H.264 with 4:2:0 colours, which every browser plays; ffmpeg writes beside the film, and the film is then renamed."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        listed = Path(folder) / "frames.txt"
        listed.write_text("".join(f"file '{picture.resolve()}'\nduration {1 / fps:.6f}\n" for picture in pictures))
        made = Path(folder) / "film.mp4"
        done = subprocess.run(
            [FFMPEG, "-loglevel", "error", "-y", "-f", "concat", "-safe", "0", "-i", str(listed), "-r", f"{fps:g}",
             "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", str(made)],
            capture_output=True, text=True, check=False)
        if done.returncode:
            raise InputError(f"{path}: ffmpeg could not write it: {done.stderr.strip() or f'exit status {done.returncode}'}")
        made.replace(path)
