"""The table of `msv2`'s commands: what each does and which function does it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command of `msv2`.

    Attributes:
        name: what the user types behind `msv2`.
        summary: one line for the list of commands.
        module: where its `main(argv)` is.
    """

    name: str
    summary: str
    module: str


_COMMANDS = (
    Command("render", "draw a scene with the integer renderer, whose pixels equal the hardware's", "golden.render"),
    Command("look", "a contact sheet of a scene from eight cameras, with the numbers to copy", "msv2.cli.look"),
    Command("frame", "run one frame through the RTL and compare it with the renderer bit for bit", "tb.frame.__main__"),
    Command("video", "a film along a camera path, with the machine's numbers below", "msv2.video.command"),
    Command("view", "look at a scene in the browser, with the machine's numbers beside it", "msv2.viewer.command"),
    Command("sim", "simulate one unit's RTL against the renderer", "tb.sim"),
    Command("synth", "synthesise a unit or a whole machine: area and timing", "synth.__main__"),
    Command("fpga", "the machine with a RISC-V core as a bitstream for an ECP5, and in simulation", "msv2.fpga.command"),
    Command("perf", "count the cycles of a frame with the cycle model, in seconds instead of minutes", "perf.__main__"),
    Command("sweep", "cycles, area and energy over many settings of machine, frame and memory", "msv2.sweep.command"),
    Command("train", "train a foveated model from photographs or from a trained model", "golden.train"),
    Command("cases", "run the hard cases on every engine", "msv2.cases.command"),
    Command("study", "list or run the experiments and reports", "msv2.studies.__main__"),
    Command("verilog", "write the machine or one unit as Verilog", "msv2.verilog.command"),
    Command("demo", "the trained model of the embedded scene, all the way to the RTL's frame, with pictures", "msv2.cli.demo"),
    Command("docs", "write the generated pages of docs/, and the site", "msv2.document.__main__"),
    Command("setup", "make or extend the virtual environment of a checkout", "msv2.cli.setup_environment"),
    Command("doctor", "say what is missing on this machine and how to get it", "msv2.cli.doctor"),
)

COMMANDS: dict[str, Command] = {command.name: command for command in _COMMANDS}
"""Commands by name, in the order of the help."""
