"""The tables as Markdown: nothing is in them that is not in the JSON beside, but for the paper's own numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from golden.training import ablation, comparison, latency

PAPERS = "The paper's values are means of 13 scenes, on a Jetson Xavier where they are speeds."


def markdown(scenes: Sequence[Mapping[str, Any]], picture: str) -> str:
    """The page.

    Args:
        scenes: records of `golden.training.tables.measure_scene`.
        picture: file name of the latency plot.
    """
    head = [
        "# Foveated training: the paper's tables", "", f"Made by `make tables-training`. {PAPERS} Ours are measured on each "
        "scene's test views, which no stage of training reads, against the photographs unless said otherwise.", "",
        "Golden cycles are an estimate from the integer renderer's frames: projection and rendering one after the other, each "
        "as long as its busiest part at one item a cycle or memory's beats at 25.6 bytes a cycle "
        "(`golden/training/frame_cycles.py`), of the machine `paper`. Foveated frames have the gaze in the centre. "
        "MMFR's frames project every model and render each in the tiles of its level.", ""]
    parts = [part for scene in scenes for part in _scene(scene)]
    plot = ["## Latency against points and against intersections", "",
            f"![latency against points and intersections]({picture})", "",
            "The dense model with shares of its points removed, none retrained; one frame of the first test view. "
            "*Off* is the mean of |ln(cycles / dense's) - ln(quantity / dense's)|: 0 where both fall at the same rate.", ""]
    return "\n".join([*head, *parts, *plot, *(part for scene in scenes for part in _latency(scene))])


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table, with an empty line behind it."""
    return "\n".join(["| " + " | ".join(head) + " |", "|---" * len(head) + "|",
                      *("| " + " | ".join(str(cell) for cell in row) + " |" for row in rows), ""])


def _scene(scene: Mapping[str, Any]) -> list[str]:
    width, height = scene["size"]
    options = ", ".join(f"{name} {value}" for name, value in scene["options"].items() if value is not None)
    views = scene["views"]
    return [
        f"## {scene['scene']}, {width}x{height}", "", f"{views['train']} views train, {views['validation']} validate, "
        f"{views['test']} test; references are {scene['references']}. Made with {options}.", "",
        "### Foveated representations", "", _comparison(scene["comparison"]),
        "### Ablation", "", "PSNR is of level 1, which foveated frames show in the fovea.", "", _ablation(scene["ablation"]),
        "### Points per level", "", _points(scene["comparison"]),
        "Opacity enhancement leaves " + ", ".join(
            f"{-share + 0.0:+.1f} % points in L{level}" for level, share in enumerate(scene["fewer_percent"], 1) if level > 1)
        + f" against training without it (the paper: up to {comparison.PAPER_FEWER_PERCENT:g} % fewer in R3 and R4), both held "
        "to L1's HVSQ on the validation views. Lowest HVSQ that training reached at a number of points, over that target:", "",
        _curves(scene["level_curves"])]


def _comparison(rows: Sequence[Mapping[str, Any]]) -> str:
    smfr = next(row for row in rows if row["method"] == comparison.SMFR)
    base = comparison.PAPER[comparison.SMFR]

    def cells(row: Mapping[str, Any]) -> list[str]:
        frame, paper = row["frame"], comparison.PAPER.get(row["method"])
        own = [row["method"], f"{row['storage_mb']:.3f}", f"{row['over_l1_percent']:+.1f} %",
               *(f"{1e5 * value:.2f}" for value in row["hvsq"]), f"{frame['entries']:,.0f}", f"{frame['cycles']:,.0f}",
               f"{smfr['frame']['cycles'] / frame['cycles']:.2f}"]
        if paper is None:
            return [*own, "", "", ""]
        return [*own, f"{paper['fps']:g} ({paper['fps'] / base['fps']:.2f})",
                f"{paper['storage_mb']:g} ({100 * (paper['storage_mb'] / base['storage_mb'] - 1):+.0f} %)",
                " / ".join(f"{value:g}" for value in paper["hvsq_e5"])]

    return table(
        ("method", "storage MB", "over L1", "HVSQ 1e-5 L1", "L2", "L3", "L4", "intersections/frame", "golden cycles/frame",
         "speed, SMFR = 1", "paper: FPS (SMFR = 1)", "paper: MB (over SMFR)", "paper: HVSQ 1e-5"),
        map(cells, rows))


def _ablation(rows: Sequence[Mapping[str, Any]]) -> str:
    dense = rows[0]

    def cells(row: Mapping[str, Any]) -> list[str]:
        frame, name = row["frame"], row["name"]
        size, speed = ablation.PAPER_SIZE_PERCENT.get(name), ablation.PAPER_SPEED.get(name)
        return [
            name, f"{row['points']:,}", f"{row['storage_mb']:.3f}", f"{100 * row['storage_mb'] / dense['storage_mb']:.1f} %",
            f"{frame['entries_per_tile']:.1f}", f"{frame['entries']:,.0f}", f"{frame['cycles']:,.0f}",
            f"{dense['frame']['entries'] / max(frame['entries'], 1):.2f}", f"{dense['frame']['cycles'] / frame['cycles']:.2f}",
            f"{row['psnr']:.2f}", f"{row['ssim']:.4f}", "" if speed is None else f"{speed:.1f}",
            "" if size is None else f"{size:g} %"]

    return table(
        ("model", "points of L1", "storage MB", "of dense", "intersections/tile", "per frame", "golden cycles/frame",
         "fewer intersections, times", "speed, dense = 1", "PSNR dB", "SSIM", "paper: speed", "paper: size"), map(cells, rows))


def _points(rows: Sequence[Mapping[str, Any]]) -> str:
    shown = [row for row in rows if row["method"] in (comparison.OURS, comparison.PLAIN)]
    return table(
        ("model", "L1", "L2", "L3", "L4"),
        [*([row["method"], *(f"{count:,} ({share:.1f} %)" for count, share in zip(
            row["points"], row["points_percent"], strict=True))] for row in shown),
         ["the predecessor, bicycle", *(f"{share:g} %" for share in comparison.PREDECESSOR_PERCENT)]])


def _curves(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    return table(
        ("level", "model", "points kept", "points: HVSQ / target"),
        ((f"L{curve['level']}", method, f"{curve['kept']:,}", ", ".join(
            f"{points:,}: {hvsq:.3f}" for points, hvsq in zip(curve["points"], curve["hvsq"], strict=True)))
         for method, own in curves.items() for curve in own))


def _latency(scene: Mapping[str, Any]) -> list[str]:
    shown, (width, height) = scene["latency"], scene["latency"]["size"]
    whole = shown["versions"][0]

    def cells(version: Mapping[str, Any]) -> list[str]:
        work, rtl = version["work"], version["rtl"]
        return [
            latency.LABELS[version["criterion"]], f"{100 * version['removed']:.0f} %", f"{version['points']:,}",
            f"{work['entries_per_tile']:.1f}", f"{work['cycles']:,.0f}", "" if rtl is None else f"{rtl['cycles']:,}",
            f"{version['points'] / whole['points']:.3f}", f"{work['entries'] / max(whole['work']['entries'], 1):.3f}",
            f"{work['cycles'] / whole['work']['cycles']:.3f}",
            "" if rtl is None else f"{rtl['cycles'] / whole['rtl']['cycles']:.3f}"]

    agreement = [[f"{latency.CYCLES[name]} cycles against {'intersections' if quantity == 'entries' else quantity}",
                  f"{of['pearson']:.4f}", f"{of['off']:.3f}"]
                 for name, by in shown["proportionality"].items() for quantity, of in by.items()]
    return [
        f"### {scene['scene']}, {width}x{height}", "",
        table(("removed by", "removed", "points", "intersections/tile", "golden cycles", "RTL cycles", "points, of dense",
               "intersections, of dense", "golden cycles, of dense", "RTL cycles, of dense"), map(cells, shown["versions"])),
        table(("", "Pearson r", "off"), agreement)]
