"""`msv2 study run write_combining`: how many memory writes would be saved if beats waited for further intersections of
their tile, in frames of real scenes.

Each of several lines would hold a beat of one tile. The tile's low bits select the line. A beat would stay until it is full or
until an intersection of another tile needs the line, and would then take one write instead of one per intersection, which is
what `rtl.tile_lists.entry_writer` makes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.tile_lists import rank_in_tile
from msv2.studies import page
from msv2.studies.record import write_report
from msv2.studies.scenes import WRITE_COMBINING as FRAMES
from msv2.studies.scenes import View, available, places
from spec.command_line import command_parser
from spec.config import PAPER
from spec.memory import BEAT_BYTES, BEAT_ENTRIES
from spec.paths import REPORTS
from tb.common.scenes import traced_frame

LINES = (64, 256, 1024, 4096)


def saved_writes(tile: np.ndarray, lines: int) -> int:
    """Number of intersections that would join a waiting beat.

    Args:
        tile: (intersections,) the tile of each intersection, in the order of arrival.
        lines: the number of beats that may wait, a power of two.
    """
    tile = np.asarray(tile, np.int64)
    order = np.argsort(tile & lines - 1, kind="stable")  # brings the intersections of each line together
    waits = np.diff(tile[order], prepend=-1) == 0
    return int((waits & (rank_in_tile(tile)[order] % BEAT_ENTRIES != 0)).sum())


def arriving_tiles(frame: Frame) -> np.ndarray:
    """(intersections,) the tile of each intersection of a frame, in the order in which the tile test finds them."""
    entries = frame.entries
    tile = np.repeat(np.arange(len(entries.start) - 1), np.diff(entries.start))
    return tile[np.lexsort((tile, entries.splat))]


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _rows(views: Sequence[View]) -> Iterator[dict[str, object]]:
    """The numbers of each frame whose scene is present."""
    for view, path in available(views):
        name, frame = traced_frame(PAPER, path, view.size)
        tile = arriving_tiles(frame)
        yield {"frame": name, "entries": len(tile), "tiles": len(frame.entries.start) - 1,
               "saved": [saved_writes(tile, lines) / len(tile) for lines in LINES]}


_HEAD = f"""# Beats that wait for more entries of their tile: writes saved

Written by `msv2 study run write_combining`. Share of one write an entry, in frames without a gaze, by the lines in
which a beat of {BEAT_BYTES} bytes waits each; a line is chosen by the tile's low bits. No more than
{_percent(1 - 1 / BEAT_ENTRIES)} can be saved.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes write_combining.json and the page write_combining.md."""
    parser = command_parser("msv2 study run write_combining", __doc__.split(": ", 1)[1])
    parser.add_argument("--out", type=Path, default=REPORTS / "write_combining.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    rows = list(_rows(FRAMES))
    write_report(args.out.with_suffix(".json"), {"config": PAPER.name, "lines": LINES, "rows": rows}, [__name__],
                 {"config": PAPER}, places(FRAMES))
    cells = [[r["frame"], f"{r['entries']:,}", f"{r['tiles']:,}", *map(_percent, r["saved"])] for r in rows]
    table = page.table(["frame", "entries", "tiles", *(f"{lines:,} lines" for lines in LINES)], cells)
    page.write_page(args.out, f"{_HEAD}\n{table}")
    print(f"{args.out}: {len(rows)} frames")
    return 0
