"""The summary and the page of the report about joint frames with a warped eye."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.memory import MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.performance.summary import geomean
from spec.config import V3_EYES_WARP
from spec.constants import ECC_THRESHOLD_DEG

JOINT, WARPED, NO_SWEEP, ALL_HOLES = "joint", "warped", "warped, holes stay", "warped from 0 degrees"
"""Kinds of frames: both eyes rendered; the second warped beyond the threshold, its holes rendered or left; and warped wherever
the first eye has something to show."""

KINDS = (WARPED, NO_SWEEP, ALL_HOLES)

Row = Mapping[str, Any]


def _of(rows: Sequence[Row], kind: str, machine: str, memory: str) -> dict[str, Row]:
    return {row["frame"]: row for row in rows if (row["kind"], row["machine"], row["memory"]) == (kind, machine, memory)}


def _pairs(rows: Sequence[Row]) -> list[tuple[str, str]]:
    return list(dict.fromkeys((row["machine"], row["memory"]) for row in rows))


def summary(rows: Sequence[Row]) -> dict[str, dict[str, float | None]]:
    """By machine and memory, how many times fewer cycles each kind of frame takes than the joint one: geometric means over the
    frames. Above 1, warping pays."""
    out = {}
    for machine, memory in _pairs(rows):
        joint = _of(rows, JOINT, machine, memory)
        out[f"{machine}, {memory}"] = {
            kind: geomean(joint[name]["cycles"] / row["cycles"] for name, row in _of(rows, kind, machine, memory).items())
            for kind in KINDS}
    return out


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    rows = content["frames"]
    means = table(("machine", "memory", *KINDS), [
        (*_named(name), *("-" if gains[kind] is None else f"{gains[kind]:.3f}" for kind in KINDS))
        for name, gains in content["summary"].items()], 2)
    parts = [
        "# A warped eye on top of joint frames",
        "Written by `msv2 study run two_eyes_warp`. docs/stereo.md describes these frames, and docs/formats.md defines them.",
        f"The cycles are those of the cycle model, for display pixels, on `{V3_EYES_WARP.name}` and on the same machine with "
        "four arrays. The frames are those of reports/v3.md: four levels and the gaze in the centre of the left eye, which is "
        "the source; the right eye looks at the same point.",
        f"*{WARPED}*: tiles beyond {ECC_THRESHOLD_DEG:g} degrees are warped, and a second sweep over the lists renders those "
        f"with holes; *{NO_SWEEP}*: without that sweep; *{ALL_HOLES}*: no tile is wanted, so that all that is rendered comes "
        "from the second sweep.",
        "## Cycles of the joint frame over those of each kind", "Geometric means. Above 1, warping pays.", means,
        *(part for machine, memory in _pairs(rows) for part in (
            f"### {machine}, {MEMORY_NAMES[memory]}", _frames(rows, machine, memory))),
        "## Tiles", "Shares of the target's tiles that the host wants, and that have holes; shares of super-tiles with a hole "
        "tile, and of pairs that are read again for them; and the share of pairs that are in the lists for warped tiles of the "
        "target alone, which a machine without a second sweep would not need.", _tiles(content["tiles"]),
        "## Pixels", "PSNR in dB of the target against the float64 oracle's, all of 8 bits a channel.",
        _quality(content["quality"])]
    return "\n\n".join(part for part in parts if part)


def _named(name: str) -> tuple[str, str]:
    machine, memory = name.rsplit(", ", 1)
    return machine, MEMORY_NAMES[memory]


def _frames(rows: Sequence[Row], machine: str, memory: str) -> str:
    joint, (warped, still, every) = _of(rows, JOINT, machine, memory), (
        _of(rows, kind, machine, memory) for kind in KINDS)
    return table(
        ("frame", JOINT, WARPED, "gain", "of it second sweep", "bytes, times joint", NO_SWEEP, "gain", ALL_HOLES, "gain"),
        [(name, f"{row['cycles']:,}", f"{warped[name]['cycles']:,}", f"{row['cycles'] / warped[name]['cycles']:.3f}",
          f"{warped[name]['sweep_cycles']:,}", f"{warped[name]['total_bytes'] / row['total_bytes']:.2f}",
          f"{still[name]['cycles']:,}", f"{row['cycles'] / still[name]['cycles']:.3f}",
          f"{every[name]['cycles']:,}", f"{row['cycles'] / every[name]['cycles']:.3f}")
         for name, row in joint.items()], 1)


def _tiles(rows: Sequence[Row]) -> str:
    names = ("tiles_foveal", "tiles_rerendered", "super_tiles_again", "pairs_again", "warped_only")
    return table(
        ("frame", "kind", "wanted", "with holes", "super-tiles again", "pairs again", "pairs of warped tiles alone"),
        [(row["frame"], row["kind"], *(f"{row[name]:.1%}" for name in names)) for row in rows], 2)


def _quality(rows: Sequence[Row]) -> str:
    kinds = (JOINT, *KINDS)
    return table(("frame", "units per metre", *kinds), [
        (row["frame"], f"{row['units_per_metre']:g} ({row['scale']})", *(f"{row[f'{kind}_db']:.1f}" for kind in kinds))
        for row in rows], 2)
