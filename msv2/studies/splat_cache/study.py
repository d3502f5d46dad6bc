"""`python -m msv2.studies splat_cache`: what a cache of splats would miss in scenes' frames, by lines, ways, policy and set.

An entry costs the 8 bytes of its place in the tile's list, and a beat where its splat is not in the cache.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.pipeline import Frame
from golden.scenes.files import atomic_output
from spec.config import PAPER, AcceleratorConfig
from spec.constants import ENTRY_BYTES, MAX_LEVELS
from spec.memory import BEAT_BYTES, DRAM_BYTES_PER_CYCLE
from spec.paths import ROOT
from tb.common.scenes import scene_path, traced_frame

SCENES = (
    ("embedded", "128x128"), ("truck.splat", "256x144"), ("truck.splat", "640x360"), ("truck.splat", "1280x720"),
    ("garden_large", "320x180"), ("rock_sh3", "320x180"))
"""Scenes, the trained ones where they are, and their sizes."""

ORGANISATIONS = (
    (1, "-", "low"), (1, "-", "fold"), (2, "fifo", "low"), (2, "lru", "low"), (4, "fifo", "low"), (4, "lru", "low"))
"""Ways, what is replaced, and what of the index chooses the set: its low bits, or all of it folded together."""

LINES = (64, 256, 512, 1024, 2048, 4096, 8192)


def accesses(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Index and level of the views that a frame's entries want, in rendering order, int64 each."""
    e = frame.entries
    return e.splat.astype(np.int64), np.repeat(frame.registers.header[:, 0], np.diff(e.start))


def table(frame: Frame) -> dict[tuple[int, str, str], list[float]]:
    """Misses as a share of the accesses, by organisation, for each of LINES."""
    index, level = accesses(frame)
    return {
        (ways, policy, place): [
            find_misses(index, level, lines, ways, policy == "lru", place == "fold").mean() for lines in LINES]
        for ways, policy, place in ORGANISATIONS}


def cycles_per_entry(share: float) -> float:
    """Cycles of the paper's memory for an entry's place in its list and its share of a miss."""
    return (ENTRY_BYTES + BEAT_BYTES * share) / DRAM_BYTES_PER_CYCLE


def _frames(config: AcceleratorConfig) -> Iterator[tuple[str, Frame]]:
    for scene, size in SCENES:
        path = scene_path(scene)
        if path is None:
            continue
        width, height = (int(number) for number in size.split("x"))
        for gaze, levels in (("none", None), (f"{width // 2},{height // 2}", 4)):
            yield traced_frame(config, path, size, gaze, levels)


def report(name: str, frame: Frame) -> list[str]:
    """A frame's table in Markdown."""
    index, level = accesses(frame)
    entries, views = len(index), len(np.unique(index * MAX_LEVELS + level))
    rates, direct = table(frame), (1, "-", "low")
    lines = [
        f"## {name}", "",
        f"{entries:,} entries in {len(frame.registers.header)} tiles, {views:,} views: at least {views / entries:.3f}.",
        "", "| lines | " + " | ".join(f"{lines:,}" for lines in LINES) + " |", "|---" * (len(LINES) + 1) + "|"]
    for organisation in ORGANISATIONS:
        ways, policy, place = organisation
        kind = f"{ways} ways, {policy}" if ways > 1 else f"direct, {'low bits' if place == 'low' else 'folded'}"
        lines.append(f"| {kind} | " + " | ".join(f"{share:.3f}" for share in rates[organisation]) + " |")
    cycles = " | ".join(f"{cycles_per_entry(share):.2f}" for share in rates[direct])
    return [*lines, f"| direct: memory cycles an entry | {cycles} |", ""]


_HEAD = f"""# Splat cache: misses, share of entries

Written by `python -m msv2.studies splat_cache`. A miss is a beat of {BEAT_BYTES} bytes, an entry's place in its list
{ENTRY_BYTES}; cycles are those of {DRAM_BYTES_PER_CYCLE} bytes each.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Writes the tables."""
    parser = argparse.ArgumentParser(prog="python -m msv2.studies splat_cache", description=__doc__.split(": ", 1)[1])
    parser.add_argument("--out", type=Path, default=ROOT / "reports" / "splat_cache.md", metavar="FILE")
    args = parser.parse_args(argv)
    lines = [_HEAD]
    for name, frame in _frames(PAPER):
        lines += report(name, frame)
    with atomic_output(args.out) as file:
        file.write(("\n".join(lines).rstrip() + "\n").encode())
    print(f"{args.out}: {sum(line.startswith('## ') for line in lines)} frames")
    return 0
