"""`msv2 view`: look at a scene in the browser, drawn by the integer renderer, with the machine's numbers beside it."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from golden.kernels import compile_seconds
from golden.scenes.request import (
    write_json,
)
from msv2.viewer.session import Session
from msv2.viewer.session_arguments import add_session_arguments, session_of
from spec.command_line import add_out_argument, command_parser
from spec.errors import InputError, run_command_line
from spec.paths import BUILD, short_path
from spec.private import output_folder

EPILOG = """\
Drag to turn, scroll to come closer, drag with the right button to move; a click sets the gaze, Shift and a click shows a splat.
Without --size, a frame has its camera's shape and at most 640x360 pixels. Ctrl-C ends the viewer.
docs/viewer.md says what every control and overlay does.

examples:
  %(prog)s truck.splat                            your own scene
  %(prog)s rock_sh3/ --gaze 320,180 --levels 4    foveated from the start
  %(prog)s scene.ply --size 1280x720 --config precise --memory lpddr3
  %(prog)s --port 9000 --host 0.0.0.0             for browsers on other machines
  %(prog)s --benchmark                            the viewer's frame time beside the renderer's own
  %(prog)s truck.splat --screenshots              pictures of the viewer itself, by a headless Chromium
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = command_parser("msv2 view", __doc__, EPILOG)
    add_session_arguments(parser)
    group = parser.add_argument_group("the viewer")
    group.add_argument("--port", type=int, default=8080, metavar="N", help="port, or the next free one (default: 8080)")
    group.add_argument("--host", default="127.0.0.1", metavar="ADDRESS",
                       help="address to listen on; 0.0.0.0 also takes browsers on other machines (default: 127.0.0.1)")
    group.add_argument("--benchmark", action="store_true",
                       help="measure frame times along a camera path without a browser, write OUT/benchmark.json, and end")
    group.add_argument("--frames", type=int, default=40, metavar="N", help="frames of --benchmark (default: 40)")
    group.add_argument("--screenshots", action="store_true",
                       help="let a headless Chromium use the viewer, write pictures of it to OUT, and end")
    add_out_argument(parser, "build/view", "folder of benchmark and screenshots")
    return parser.parse_args(argv)


def make_session(args: argparse.Namespace) -> Session:
    """The session that parsed arguments describe.

    Raises:
        InputError: an argument is not accepted.
    """
    if not 0 <= args.port <= 65535:
        raise InputError(f"port {args.port} is not accepted: 0..65535 are")
    if args.frames < 4:
        raise InputError(f"frames {args.frames} is not accepted: 4 or more is")
    return session_of(args)


def warm_up(session: Session) -> None:
    """Draws and reckons a tiny frame, so that kernels are compiled or loaded before the first picture is wanted."""
    tiny = replace(session.state.resized(64, 48), gaze=None, eyes="one", overlay="none")
    session.picture(tiny)
    session.numbers(tiny)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the viewer until Ctrl-C."""
    args = parse_arguments(argv)
    import viser  # noqa: F401  # so that a missing package is reported before the scene is loaded

    begin = time.perf_counter()
    session = make_session(args)
    warm_up(session)
    compiled = f", {compile_seconds():.0f} s of it compiling" if compile_seconds() else ""
    print(f"{session.name} is ready after {time.perf_counter() - begin:.1f} s{compiled}", flush=True)
    if args.benchmark:
        from msv2.viewer.benchmark import benchmark, report

        with output_folder(args.out, BUILD / "view") as out:
            numbers = benchmark(session, args.frames)
            write_json(out / "benchmark.json", numbers)
        print(f"{report(numbers)}\nwritten: {short_path(out / 'benchmark.json')}")
        return 0
    if args.screenshots:
        from msv2.viewer.screenshots import take

        with output_folder(args.out, BUILD / "view") as out:
            print("\n".join(f"written: {short_path(path)}" for path in take(session, out)))
        return 0
    from msv2.viewer.server import Viewer

    viewer = Viewer(session, args.host, args.port)
    with suppress(KeyboardInterrupt):
        print(f"open {viewer.url} in a browser; Ctrl-C ends the viewer", flush=True)
        viewer.wait()
    viewer.close()
    print("viewer ended")
    return 0


if __name__ == "__main__":
    run_command_line(main)
