"""`msv2`: every command of the project below one name.

Each command is the `main(argv)` of the room that does the work; this module finds it, imports it and says under which name
it was called. Nothing of ours is imported before it is known which command is wanted, so that the help appears at once and
a missing package only affects the command that needs it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from msv2.cli.commands import COMMANDS, Command
from spec.command_line import called_as, choice
from spec.errors import InputError, run_command_line
from spec.extras import EXTRAS, how_to_get

EXAMPLES = """\
examples:
  msv2 render                                       draw the trained model of the embedded scene
  msv2 render truck.splat --size 640x360 --gaze 320,180 --levels 4
  msv2 frame --config tiny --size 64x48             one frame through the RTL, compared bit for bit
  msv2 perf --config paper --set splat_cache_lines=4096
  msv2 verilog --config tiny --out build/verilog    Verilog for your own design
  msv2 study list                                   the experiments behind the reports
  msv2 doctor                                       what is missing here, and how to get it

msv2 COMMAND --help shows the options of a command."""


def help_text() -> str:
    """What `msv2 --help` prints."""
    width = max(map(len, COMMANDS))
    lines = [f"  {c.name:<{width}}  {c.summary}" for c in COMMANDS.values()]
    return "\n".join([
        "usage: msv2 COMMAND ...", "", "An open accelerator for foveated 3D Gaussian Splatting.", "", "commands:", *lines, "",
        EXAMPLES])


def version_text() -> str:
    """What `msv2 --version` prints."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"msv2 {version('msv2')}"
    except PackageNotFoundError:
        return "msv2 (not installed)"


def run_subcommand(command: Command, argv: Sequence[str]) -> int:
    """Runs a command; its exit status.

    Raises:
        InputError: as the command does, or a package that it needs is not installed.
    """
    with called_as(f"msv2 {command.name}"):
        try:
            return import_module(command.module).main(list(argv)) or 0
        except ModuleNotFoundError as error:
            package = (error.name or "").partition(".")[0]
            if package not in EXTRAS:
                raise
            raise InputError(
                f"msv2 {command.name} needs {package}, which is not installed; {how_to_get(package)}") from error


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command that the first argument names with the rest of the arguments; the exit status.

    Raises:
        InputError: there is no such command; the message names the nearest. Or as `run_subcommand`.
    """
    name, *rest = (sys.argv[1:] if argv is None else list(argv)) or ["--help"]
    if name == "help" and rest:
        name, rest = rest[0], ["--help"]
    if name in ("-h", "--help", "help"):
        print(help_text())
        return 0
    if name == "--version":
        print(version_text())
        return 0
    return run_subcommand(COMMANDS[choice("command", name, COMMANDS)], rest)


def run() -> None:
    """The console script: `main` with exit status 2 after bad input and 130 after Ctrl-C."""
    run_command_line(main)
