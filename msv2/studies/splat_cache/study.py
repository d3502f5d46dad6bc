"""`msv2 study run splat_cache`: the miss rates of splat caches in frames of real scenes, by lines, ways, policy and
set.

An intersection costs 8 bytes for its place in the tile's list, and a beat where its splat record is not in the cache.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.pipeline import Frame
from msv2.studies import page
from msv2.studies.record import write_report
from msv2.studies.scenes import SPLAT_CACHE, available, places
from spec.command_line import command_parser
from spec.config import PAPER, AcceleratorConfig
from spec.constants import ENTRY_BYTES, MAX_LEVELS
from spec.memory import BEAT_BYTES, DRAM_BYTES_PER_CYCLE
from spec.paths import REPORTS
from tb.common.scenes import traced_frame

ORGANISATIONS = (
    (1, "-", "low"), (1, "-", "fold"), (2, "fifo", "low"), (2, "lru", "low"), (4, "fifo", "low"), (4, "lru", "low"))
"""The number of ways, the replacement policy, and which bits of the index choose the set: the low bits, or all bits folded."""

LINES = (64, 256, 512, 1024, 2048, 4096, 8192)


def accesses(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Index and level of the splat records that a frame's intersections need, in rendering order, each as int64."""
    e = frame.entries
    return e.splat.astype(np.int64), np.repeat(frame.registers.header[:, 0], np.diff(e.start))


def table(frame: Frame) -> dict[tuple[int, str, str], list[float]]:
    """The misses as a share of the accesses, for each organisation and each of LINES."""
    index, level = accesses(frame)
    return {
        (ways, policy, place): [
            find_misses(index, level, lines, ways, policy == "lru", place == "fold").mean() for lines in LINES]
        for ways, policy, place in ORGANISATIONS}


def cycles_per_entry(share: float) -> float:
    """Cycles of the paper's memory for an intersection's place in its list and for its share of misses."""
    return (ENTRY_BYTES + BEAT_BYTES * share) / DRAM_BYTES_PER_CYCLE


def _frames(config: AcceleratorConfig) -> Iterator[tuple[str, Frame]]:
    for view, path in available(SPLAT_CACHE):
        width, height = (int(number) for number in view.size.split("x"))
        for gaze, levels in (("none", None), (f"{width // 2},{height // 2}", 4)):
            yield traced_frame(config, path, view.size, gaze, levels)


def measure(name: str, frame: Frame) -> dict[str, object]:
    """The numbers of a frame, in a form that JSON can store."""
    index, level = accesses(frame)
    return {
        "frame": name, "entries": len(index), "tiles": len(frame.registers.header),
        "views": len(np.unique(index * MAX_LEVELS + level)),
        "misses": [{"ways": ways, "policy": policy, "set": place, "shares": shares}
                   for (ways, policy, place), shares in table(frame).items()]}


def report(row: Mapping[str, Any]) -> str:
    """The section about a frame, as Markdown."""
    entries, views = row["entries"], row["views"]
    cells = []
    for found in row["misses"]:
        ways, policy, place = found["ways"], found["policy"], found["set"]
        kind = f"{ways} ways, {policy}" if ways > 1 else f"direct, {'low bits' if place == 'low' else 'folded'}"
        cells.append([kind, *(f"{share:.3f}" for share in found["shares"])])
    cells.append(["direct: memory cycles an entry", *(f"{cycles_per_entry(s):.2f}" for s in row["misses"][0]["shares"])])
    return (f"## {row['frame']}\n\n{entries:,} entries in {row['tiles']} tiles, {views:,} views: at least "
            f"{views / entries:.3f}.\n\n" + page.table(["lines", *(f"{lines:,}" for lines in LINES)], cells))


_HEAD = f"""# Splat cache: misses, share of entries

Written by `msv2 study run splat_cache`. A miss is a beat of {BEAT_BYTES} bytes, an entry's place in its list
{ENTRY_BYTES}; cycles are those of an ideal memory, {DRAM_BYTES_PER_CYCLE} bytes each.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes splat_cache.json and the page splat_cache.md."""
    parser = command_parser("msv2 study run splat_cache", __doc__.split(": ", 1)[1])
    parser.add_argument("--out", type=Path, default=REPORTS / "splat_cache.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    rows = [measure(name, frame) for name, frame in _frames(PAPER)]
    write_report(args.out.with_suffix(".json"), {"config": PAPER.name, "lines": LINES, "rows": rows}, [__name__],
                 {"config": PAPER}, places(SPLAT_CACHE))
    page.write_page(args.out, "\n".join([_HEAD, "\n\n".join(map(report, rows))]))
    print(f"{args.out}: {len(rows)} frames")
    return 0
