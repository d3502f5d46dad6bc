"""Why a tile has 16 pixels and an array at most 16x16 cores: work, memory traffic, cycles and area at 8, 16 and 32.

    msv2 study run tile_size            build/tile_size/tile_size.{json,md}
    msv2 study run tile_size --keep     reports/tile_size.json and docs/tile_size.md
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from golden.scenes.request import make_folder, parse_request, resolve
from msv2.studies.memory import MEMORY_NAMES, memory_arguments
from msv2.studies.page import write_page
from msv2.studies.record import write_report
from msv2.studies.scenes import TILE_SIZE, available, places
from msv2.studies.tile_size.area import array_mm2, basis, output_mm2, tile_memory_mm2
from msv2.studies.tile_size.measure import ARRAYS, measured
from msv2.studies.tile_size.page import page
from perf.model import MemoryModel, simulate
from perf.trace import trace_request
from spec.command_line import command_parser
from spec.config import PAPER
from spec.paths import DOCS, REPORTS, cache_folder

CACHE = cache_folder("traces")


def frames() -> Iterator[dict[str, object]]:
    """The rows of all frames whose scenes are there."""
    for view, path in available(TILE_SIZE):
        args = parse_request(path, *view.arguments)
        yield {"scene": view.scene, "size": view.size, **measured(resolve(args)), **_modelled(args)}


def _modelled(args: object) -> dict[str, object]:
    """What the integer renderer and the cycle model say of the tile size that there is."""
    trace = trace_request(args, PAPER, cache=CACHE)
    machines = {array.name: PAPER.with_(cores_x=array.cores, cores_y=array.cores) for array in ARRAYS if array.expressible}
    cycles = {memory: {name: simulate(trace, machine, memory=MemoryModel(**memory_arguments(memory)), display=True).total
                       for name, machine in machines.items()} for memory in MEMORY_NAMES}
    return {"golden_intersections": trace.entries, "model_cycles": cycles}


def areas() -> list[dict[str, object]]:
    """Area in mm^2 at 16 nm of what depends on the tile's size."""
    return [{"tile": array.tile, "cores": array.cores, "array_mm2": array_mm2(array),
             "tile_memory_mm2": tile_memory_mm2(array.tile), "output_mm2": output_mm2(array), "basis": basis(array)}
            for array in ARRAYS]


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = command_parser("msv2 study run tile_size", __doc__)
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: reports and docs)")
    args = parser.parse_args(argv)
    content = {"config": PAPER.name, "frames": list(frames()), "areas": areas()}
    report, text = (make_folder(args.out),) * 2 if args.out else (REPORTS, DOCS)
    write_report(report / "tile_size.json", content, [__name__], {"config": PAPER}, places(TILE_SIZE))
    write_page(text / "tile_size.md", page(content))
    return 0
