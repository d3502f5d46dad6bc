"""`msv2 fpga`: the machine with a RISC-V core as a bitstream for an ECP5, and the same system in simulation.

The steps are: compile the firmware, synthesise, place and route, write the bitstream, simulate. Each is kept, and a run that
was interrupted goes on where it was. report.json says what was found. Exit status 1 where the machine does not fit, misses its
clock, or renders a wrong pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from golden.scenes.request import make_folder, write_json
from msv2.fpga import flow, soc, tools
from spec.command_line import add_out_argument, choice, command_parser
from spec.config import FPGA
from spec.errors import InputError, run_command_line
from spec.overrides import config_record
from spec.paths import BUILD, IN_CHECKOUT, short_path

EXAMPLES = """\
examples:
  %(prog)s                     everything, for the part LFE5UM5G-85F; it goes on where it was interrupted
  %(prog)s --part synthesis    what the system takes, without placing it
  %(prog)s --part soc          only the simulation: the firmware renders a frame, compared bit for bit
  %(prog)s --part unrouted     both of these
  %(prog)s --device 85k        for the part LFE5U-85F of the lowest speed grade
  %(prog)s --seed 2            another placement
"""

PARTS = ("all", "unrouted", "synthesis", "bitstream", "soc")
DEFAULT_OUT = BUILD / "fpga"


def packages(part: str) -> list[str]:
    """The packages that a part of the command needs."""
    placing = [tools.NEXTPNR] if part in ("all", "bitstream") else []
    return [tools.ZIG, tools.PROCESSOR, *([] if part == "soc" else [tools.YOSYS]), *placing]


def build(folder: Path, part: str, device: flow.Device, seed: int) -> dict[str, object]:
    """Does the steps of a part and returns the report.

    Args:
        folder: where everything is written; it exists.
        part: one of PARTS.
        device: the FPGA.
        seed: the seed of the placement.
    """
    steps = flow.Steps(folder)
    words = flow.firmware(steps)
    source = flow.rtlil(FPGA, words, folder)
    report: dict[str, object] = {
        "device": device.name, "machine": config_record(FPGA), "target_mhz": flow.CLOCK_MHZ, "seed": seed,
        "firmware_bytes": 4 * len(words)}
    if part != "soc":
        cells = flow.synthesise(steps, source)
        report |= {"cells": cells, **flow.counted(cells, device)}
    if part in ("all", "bitstream"):
        placed = flow.place(steps, device, seed)
        report |= flow.routed_report(flow.route(steps, device, placed), flow.pack(steps))
    if part in ("all", "unrouted", "soc"):
        found = soc.simulate(steps, FPGA, source)
        report |= {"soc": found, "soc_bit_exact": found["bit_exact"]}
    return report | {"seconds": steps.seconds, "tools": tools.versions() if not tools.missing() else {}}


def wrong(report: dict[str, object]) -> list[str]:
    """What a report says against the machine; empty where all is well."""
    rules = (
        ("enough", True, "the netlist takes more than the part has"), ("fits", True, "the machine does not fit the part"),
        ("fmax_mhz", flow.CLOCK_MHZ, f"the clock is below {flow.CLOCK_MHZ} MHz"),
        ("soc_bit_exact", True, "the system's frame differs from the golden renderer's"))
    return [text for name, least, text in rules if name in report and report[name] < least]


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = command_parser("msv2 fpga", __doc__, EXAMPLES)
    parser.add_argument("--part", metavar="PART", default="all", help=f"{', '.join(PARTS)} (default: all)")
    parser.add_argument("--device", metavar="NAME", default=next(iter(flow.DEVICES)),
                        help=f"{', '.join(flow.DEVICES)} (default: {next(iter(flow.DEVICES))})")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the placement (default: 1)")
    add_out_argument(parser, "build/fpga")
    args = parser.parse_args(argv)
    part, device = choice("part", args.part, PARTS), flow.DEVICES[choice("device", args.device, flow.DEVICES)]
    if not IN_CHECKOUT:
        raise InputError("msv2 fpga works in a checkout, which has the firmware's sources in examples/fpga")
    tools.check(packages(part))
    folder = make_folder(Path(args.out) if args.out else DEFAULT_OUT)
    report = build(folder, part, device, args.seed)
    write_json(folder / "report.json", report)
    for line in summary(report):
        print(line)
    print(f"{short_path(folder / 'report.json')} has all numbers")
    complaints = wrong(report)
    for line in complaints:
        print(f"FAIL: {line}")
    return int(bool(complaints))


def summary(report: dict[str, object]) -> list[str]:
    """What a report says, in a few lines."""
    lines = []
    if "used" in report:
        used, of = report["used"], report["of"]
        lines.append(f"{report['device']}: " + ", ".join(
            f"{used[kind]:,} of {of[kind]:,} {kind.upper()}" for kind in used))
    if "fmax_mhz" in report:
        lines.append(f"placed and routed: {report['fmax_mhz']:.1f} MHz, bitstream of {report['bitstream_bytes']:,} bytes")
    if "soc" in report:
        found = report["soc"]
        lines.append(f"frame of {found['size'][0]}x{found['size'][1]} pixels by the firmware: "
                     f"{'bit-exact' if found['bit_exact'] else 'WRONG'}")
    return lines


if __name__ == "__main__":
    run_command_line(main)
