"""Fills the cache of compiled kernels, so that the first frame of `msv2 render`, `msv2 perf` and their like starts at once.

It renders and models small frames of every kind: one eye and two, with and without foveation, with and without spherical
harmonics, on both memories. Set-up calls it: `msv2 setup --warm`, `make setup WARM=1`.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from golden import render
from golden.kernels import compile_seconds, compiled_kernels
from golden.scenes.embedded.scene import cached_embedded_model
from golden.scenes.save import save_model
from perf import __main__ as perf
from spec.command_line import command_parser
from spec.errors import run_command_line
from spec.progress import as_time

SIZE = ("--size", "64x48")
FOVEATED = ("--gaze", "30,20", "--levels", "4")


@dataclass(frozen=True)
class Warmer:
    """A frame that compiles kernels: what it is, the command's function, and its arguments."""

    what: str
    command: Callable[[Sequence[str]], object]
    arguments: tuple[str, ...]


def warmers(plain: Path) -> tuple[Warmer, ...]:
    """The frames; `plain` is a model without spherical harmonics."""
    return (
        Warmer("renderer: a frame beside the float64 oracle", render.main, ("embedded", "--compare", "oracle")),
        Warmer("renderer: a foveated frame with depth", render.main, ("embedded", *FOVEATED, "--depth", "--compare", "oracle")),
        Warmer("renderer: two eyes", render.main, ("embedded", *FOVEATED, "--stereo")),
        Warmer("renderer: a scene without spherical harmonics", render.main, (str(plain),)),
        Warmer("cycle model: a frame", perf.main, ("embedded", "--no-cache")),
        Warmer("cycle model: a foveated frame", perf.main, ("embedded", *FOVEATED, "--no-cache")),
        Warmer("cycle model: two eyes", perf.main,
               ("embedded", *FOVEATED, "--stereo", "--config", "paper", "--pixels", "display", "--no-cache")),
        Warmer("cycle model: lists by tile", perf.main, ("embedded", "--config", "paper", "--no-cache")),
        Warmer("cycle model: the baseline", perf.main, (str(plain), "--merge", "0", "--pipeline", "0", "--no-cache")),
        Warmer("cycle model: ideal memory", perf.main, (str(plain), "--memory", "ideal", "--config", "paper", "--no-cache")),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the frames and prints what was compiled."""
    command_parser("python -m msv2.cli.warm", __doc__).parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain.ply"
        save_model(cached_embedded_model().with_sh_degree(0), plain)
        for item in warmers(plain):
            before = compile_seconds()
            with contextlib.redirect_stdout(io.StringIO()):
                item.command([*item.arguments, *SIZE, "--out", str(Path(folder) / "out")])
            if compile_seconds() > before:
                print(f"{item.what}: compiled in {as_time(compile_seconds() - before)}", flush=True)
    count = compiled_kernels()
    print(f"{count} kernels compiled in {as_time(compile_seconds())}" if count else "all kernels are in the cache already")
    return 0


if __name__ == "__main__":
    run_command_line(main)
