"""`msv2 study run energy`: the energy of frames by unit, with its sources, for reports/energy.{json,md,png}.

The operations and cycles of a frame come from the cycle model, with LPDDR3 and beside it with the ideal memory as a bound, or
from the RTL's own counters, with the memory that the RTL was simulated with. The counters are read from a
frame.json that `python -m tb.frame` wrote, and from the frames in reports/machine.json. The energies of operations are in
reports/energy_per_operation.json, which `msv2 study run energy_per_operation` measures.

examples:
  msv2 study run energy                                     the embedded scene and those of MSV2_DATA, and the frames of
                                                            reports/machine.json
  msv2 study run energy truck.splat --size 1280x720         one frame
  msv2 study run energy --frame build/frame/frame.json      a frame through the RTL
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from golden.scenes.camera_options import ORBIT
from golden.scenes.level_source import RANDOM
from golden.scenes.request import add_request_arguments, add_stereo_arguments, make_folder, take_stereo_arguments
from msv2.studies.destination import newest
from msv2.studies.energy.frame import EnergyReport, counter_counts, frame_energy
from msv2.studies.energy.page import OTHERS, as_markdown, plot
from msv2.studies.energy.table import TABLE, Table, load_table
from msv2.studies.memory import IDEAL, LPDDR3, MEMORY_NAMES, memory_arguments
from msv2.studies.page import write_page
from msv2.studies.record import commit, write_report
from msv2.studies.scenes import ENERGY, available, places
from spec.command_line import command_parser
from spec.config import V3
from spec.effects import with_two_eyes
from spec.errors import InputError
from spec.extras import how_to_get
from spec.memory import DRAM_BYTES_PER_CYCLE
from spec.overrides import add_config_arguments, config_from, recorded_config
from spec.paths import REPORTS, ROOT, cache_folder

CACHE = cache_folder("traces")
MACHINE = REPORTS / "machine.json"
"""The report of frames through the RTL with its counters (`make results`)."""


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run energy", __doc__)
    add_request_arguments(parser, size="640x360")
    parser.set_defaults(scene=None, camera=ORBIT, levels_from=RANDOM)
    add_stereo_arguments(parser)
    add_config_arguments(parser, "paper", ", which is measured")
    parser.add_argument("--clock-mhz", type=float, default=1000.0, help="clock frequency in MHz (default: 1000)")
    parser.add_argument("--memory", default="both", choices=(*MEMORY_NAMES, "both"),
                        help="memory of the cycle model (default: both, LPDDR3 first)")
    parser.add_argument("--frame", type=Path, metavar="FILE",
                        help="frame.json of a frame that the RTL rendered, instead of a scene")
    parser.add_argument("--table", type=Path, default=TABLE, metavar="FILE",
                        help=f"energies per operation (default: {TABLE.relative_to(ROOT)})")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="output folder (default: build/reports; --keep: reports)")
    return parser.parse_args(argv)


def modelled(args: argparse.Namespace, table: Table) -> list[dict[str, object]]:
    """The energy of a frame by the cycle model with each memory that is asked for, with a description of the frame."""
    from msv2.studies.energy.modelled import modelled_energy  # imported here because the kernels are compiled at first use
    from perf.frames import simulate, trace_request
    from perf.model import MemoryModel

    config = config_from(args)
    config = with_two_eyes(config) if args.stereo else config
    trace = trace_request(args, config, cache=CACHE)
    found = []
    for memory in MEMORY_NAMES if args.memory == "both" else (args.memory,):
        cycles = simulate(trace, config, memory=MemoryModel(**memory_arguments(memory), clock_ns=1e3 / args.clock_mhz),
                          display=True)
        report = modelled_energy(trace, cycles, config, table, clock_hz=1e6 * args.clock_mhz)
        found.append(_frame(str(args.scene), [trace.width, trace.height], trace.record, "cycle model", memory, config.name,
                            report))
    return found


def counted(frame: Mapping[str, object], table: Table, clock_mhz: float) -> dict[str, object]:
    """The energy of a frame through the RTL, by its counters. With the bench's ideal memory, DRAM's activates and refreshes are
    not in it."""
    counts, config = counter_counts(frame), recorded_config(frame)
    report = frame_energy(counts, counted_cycles(frame), config, table, clock_hz=1e6 * clock_mhz)
    return _frame(frame["scene"], frame["size"], frame, "RTL counters", str(frame.get("memory", IDEAL)), config.name, report)


def counted_cycles(frame: Mapping[str, object]) -> int:
    """The length of a frame through the RTL, without the clearing that follows a reset."""
    return sum(frame[f"{phase}_cycles"] for phase in ("table", "geometry", "render"))


def read_frames(path: Path) -> list[dict[str, object]]:
    """The frame of a frame.json, or those frames of a larger report that have merging, pipelining and the paper's bandwidth,
    LPDDR3 first.

    Raises:
        InputError: the file is neither.
    """
    try:
        content = json.loads(path.read_text())
        if "rows" not in content:
            counter_counts(content)
            return [content]
        found = [row for row in content["rows"]
                 if row["merge"] and row["pipeline"] and row["entries"]
                 and (row.get("memory") == LPDDR3 or row["bytes_per_cycle"] == DRAM_BYTES_PER_CYCLE)]
        return sorted(found, key=lambda row: row.get("memory") != LPDDR3)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} must be a frame.json of `python -m tb.frame` ({error})") from error


def _frame(
    scene: str, size: list[int], record: dict[str, object], source: str, memory: str, config: str, report: EnergyReport,
) -> dict[str, object]:
    return {"scene": Path(scene).stem, "size": size, "gaze": record.get("gaze"), "levels": record.get("levels"),
            "config": config, "work": source, "memory": memory, **_rounded(report.as_json())}


def _rounded(value: object) -> object:
    """JSON with every float at six significant digits: more says nothing, and takes half of the file."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def requests(args: argparse.Namespace) -> Iterator[argparse.Namespace]:
    """The requested frames. Without a scene, those of one eye are also asked for on the machine with lists by super-tile."""
    if args.scene is not None:
        yield args
        return
    for name in dict.fromkeys((args.config, *[V3.name] * (not args.stereo))):
        for view, path in available(ENERGY):
            yield argparse.Namespace(**{**vars(args), "config": name, "scene": path, "size": view.size, "gaze": view.gaze,
                                        "levels": 4})


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = _arguments(argv)
    config_from(args)  # raises for a wrong configuration before anything is rendered
    if not 1 <= args.clock_mhz <= 1e5:
        raise InputError(f"clock of {args.clock_mhz!r} MHz is not accepted: 1 to 100,000 is")
    take_stereo_arguments(args)
    table = load_table(args.table)
    files = [args.frame] if args.frame else [MACHINE] if args.scene is None and MACHINE.is_file() else []
    frames = [frame for request in requests(args) if not args.frame for frame in modelled(request, table)]
    frames += [counted(frame, table, args.clock_mhz) for path in files for frame in read_frames(path)]
    print("\n".join(map(summary, frames)), flush=True)
    make_folder(args.out)
    content = {"commit": commit(), "measured_at": table.commit, "node": table.node, "scaling": table.scaling,
               "prices": price_list(frames), "frames": frames, "others": OTHERS}
    scenes = [args.scene] if args.scene is not None else places(ENERGY)
    write_report(args.out / "energy.json", content, [__name__], {"arguments": args, "machine": config_from(args)},
                 [args.table, *files, *scenes])
    write_page(args.out / "energy.md", as_markdown(content, table))
    drawn = plot(frames, args.out / "energy.png")
    picture = ", energy.png" if drawn else f"; no picture without matplotlib; {how_to_get('matplotlib')}"
    print(f"wrote {newest(args.out / 'energy.json')}, energy.md{picture}")
    return 0


def price_list(frames: Sequence[dict[str, object]]) -> list[dict[str, object]]:
    """The energy of one operation for every unit, part and operation of the frames, each once, with its node, source and
    scaling. It takes the rows out of the frames, which keep their sums and the numbers of operations."""
    priced: dict[str, dict[str, object]] = {}
    for frame in frames:
        for row in frame.pop("rows"):
            price = {key: value for key, value in row.items() if key not in ("value_mj", "operations")}
            priced.setdefault(json.dumps(price), price)
    return list(priced.values())


def summary(frame: dict[str, object]) -> str:
    """The line of a frame in the printed report."""
    width, height = frame["size"]
    memory = MEMORY_NAMES[frame["memory"]]
    energies = ", ".join(f"{name} {frame[key]:.3f} mJ" for name, key in (
        ("chip", "chip_mj"), ("DRAM", "dram_mj"), ("assumed", "assumed_mj")))
    return (f"{frame['scene']} {width}x{height}, {frame['work']}, {memory}: {energies}; {frame['frames_per_s']:.0f} frames/s "
            f"at {frame['clock_hz'] / 1e6:.0f} MHz")
