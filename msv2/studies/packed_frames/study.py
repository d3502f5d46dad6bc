"""`msv2 study run packed_frames`: how many bytes of the format for displays packed frames move, in frames of real scenes, in
noise and in one colour.

Every frame is packed, unpacked and compared. The frames are foveated, with the gaze in their centre.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from golden.host.packed_frame import unpack_frame
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import display_bytes, pack_frame
from golden.msv2_ref.pipeline import render
from golden.scenes.request import parse_request, resolve
from msv2.studies import page
from msv2.studies.record import write_report
from msv2.studies.scenes import ENERGY as FRAMES
from msv2.studies.scenes import available, places
from spec.command_line import command_parser
from spec.config import PAPER
from spec.memory import BEAT_BYTES
from spec.packed import SLOT_BEATS, packed_beats
from spec.paths import REPORTS

SYNTHETIC = (640, 360)
"""Size of the frames of noise and of one colour."""


def measured(name: str, size: str, pixels: np.ndarray) -> dict[str, object]:
    """The numbers of a frame, (height, width, 4) uint8.

    Raises:
        RuntimeError: the frame does not come back bit for bit.
    """
    height, width = pixels.shape[:2]
    packed = pack_frame(pixels)
    if not np.array_equal(unpack_frame(packed.region().reshape(-1), width, height), pixels):
        raise RuntimeError(f"{name}, {size}: the packed frame does not come back")
    table = packed_beats(width, height) - SLOT_BEATS * len(packed.sizes)
    return {"frame": name, "size": size, "display_bytes": pixels.size, "packed_bytes": BEAT_BYTES * packed.moved_beats,
            "ratio": BEAT_BYTES * packed.moved_beats / pixels.size, "table_bytes": BEAT_BYTES * table,
            "blocks_by_size": np.bincount(packed.sizes, minlength=SLOT_BEATS + 1).tolist()}


def _rendered() -> Iterator[dict[str, object]]:
    """The numbers of each frame whose scene is present."""
    for view, path in available(FRAMES):
        asked = resolve(parse_request(path, *view.arguments))
        frame = render(asked.model, asked.camera, config=PAPER, foveation=asked.foveation, background=asked.background)
        yield measured(view.scene, view.size, display_bytes(display_pixels(frame)))


def _synthetic() -> Iterator[dict[str, object]]:
    """The numbers of frames that bound the others."""
    width, height = SYNTHETIC
    rng = np.random.default_rng(0)
    for name, pixels in (("noise", rng.integers(0, 256, (height, width, 4), np.uint8)),
                         ("one colour", np.full((height, width, 4), 77, np.uint8))):
        yield measured(name, f"{width}x{height}", pixels)


def mean_ratio(rows: Sequence[dict], size: str) -> float:
    """The geometric mean of the ratios of the frames of a size; nan where there is none."""
    found = [math.log(row["ratio"]) for row in rows if row["size"] == size]
    return math.exp(sum(found) / len(found)) if found else math.nan


_HEAD = """# Packed frames: bytes that are moved

Written by `msv2 study run packed_frames`. Ratio: bytes of a packed frame's used beats and of its table over those of the frame
in the format for displays, four bytes a pixel. A block is 16 by 4 pixels; unpacked it has eight beats.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes packed_frames.json and the page packed_frames.md."""
    parser = command_parser("msv2 study run packed_frames", __doc__.split(": ", 1)[1])
    parser.add_argument("--out", type=Path, default=REPORTS / "packed_frames.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    rendered, bounds = list(_rendered()), list(_synthetic())
    sizes = list(dict.fromkeys(view.size for view in FRAMES))
    means = {size: mean_ratio(rendered, size) for size in sizes}
    write_report(args.out.with_suffix(".json"), {"config": PAPER.name, "rows": rendered, "bounds": bounds, "means": means},
                 [__name__], {"config": PAPER}, places(FRAMES))
    head = ["frame", "size", "unpacked, MB", "packed, MB", "ratio", "beats of a block", "plain blocks"]
    cells = [[r["frame"], r["size"], f"{r['display_bytes'] / 1e6:.3f}", f"{r['packed_bytes'] / 1e6:.3f}", f"{r['ratio']:.3f}",
              f"{_mean_beats(r['blocks_by_size']):.2f}", f"{r['blocks_by_size'][SLOT_BEATS]:,}"] for r in (*rendered, *bounds)]
    lines = "\n".join(f"- {size}: {mean:.3f}" for size, mean in means.items())
    table = page.table(head, cells, left=2)
    page.write_page(args.out, f"{_HEAD}\n{table}\n\nGeometric means of the rendered frames:\n\n{lines}")
    print(f"{args.out}: {len(rendered)} frames, ratios {min((r['ratio'] for r in rendered), default=math.nan):.3f} to "
          f"{max((r['ratio'] for r in rendered), default=math.nan):.3f}")
    return 0


def _mean_beats(counts: Sequence[int]) -> float:
    """Beats of a block with pixels of the frame, of how many blocks have 0, 1, ... beats."""
    return sum(size * count for size, count in enumerate(counts)) / max(1, sum(counts[1:]))
