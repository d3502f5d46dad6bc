"""The tables as Markdown. Except for the paper's numbers, all their content is in the JSON file beside them.

The module needs no torch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from msv2.studies import page
from msv2.studies.cycles import CYCLES, cycles_of, explained
from msv2.studies.training import labels
from msv2.studies.training.labels import reached
from msv2.studies.training.targets_text import equal_target, own_targets, targets_rows

PAPERS = "The paper's values are means of 13 scenes, on a Jetson Xavier where they are speeds."

LATENCY_HEAD = """## Latency against points and against intersections

The dense model with shares of its points removed, none retrained; one frame of the first test view. *Off* is the mean of
|ln(cycles / dense's) - ln(quantity / dense's)|: 0 where both fall at the same rate.
"""


def markdown(scenes: Sequence[Mapping[str, Any]], picture: str) -> str:
    """The page.

    Args:
        scenes: records of `msv2.studies.training.tables.measure_scene`.
        picture: file name of the latency plot.
    """
    head = [
        "# Foveated training: the paper's tables", "", f"Made by `make tables-training`. {PAPERS} Ours are measured on each "
        "scene's test views, which no stage of training reads, against the photographs unless said otherwise.", "",
        f"All cycles are of the machine `paper`. {explained(_works(scenes))} Foveated frames have the gaze in the centre. "
        "MMFR's frames project every model and render each in the tiles of its level.", ""]
    targets = ["## Targets", "", targets_table(scenes)] if any(True for scene in scenes for _ in targets_rows(scene)) else []
    parts = [part for scene in scenes for part in _scene(scene)]
    timed = [scene for scene in scenes if "latency" in scene]
    shown = ["## Plots", "", f"![latency against points and intersections, and HVSQ of levels against points]({picture})", ""]
    plotted = shown if any("latency" in scene or "level_curves" in scene for scene in scenes) else []
    latencies = [LATENCY_HEAD, *map(latency_text, timed)] if timed else []
    return "\n".join([*head, *targets, *parts, *plotted, *latencies])


def _works(scenes: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Every recorded frame that has cycles."""
    for scene in scenes:
        for part in ("comparison", "ablation", "pruning"):
            yield from (row["frame"] for row in scene.get(part, ()))
        yield from (version["work"] for version in scene.get("latency", {}).get("versions", ()))


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table, followed by an empty line."""
    return f"{page.table(head, rows)}\n"


def targets_table(scenes: Sequence[Mapping[str, Any]]) -> str:
    """The targets, with the measured values and the verdicts."""
    return table(("scene", "target", "measured", ""), (
        (scene_title(scene), *row) for scene in scenes for row in targets_rows(scene)))


def scene_title(scene: Mapping[str, Any]) -> str:
    """The name and the size of a scene."""
    return "{}, {}x{}".format(scene["scene"], *scene["size"])


def _scene(scene: Mapping[str, Any]) -> list[str]:
    options = ", ".join(f"{name} {value}" for name, value in scene["options"].items() if value is not None)
    views = scene["views"]
    parts = [
        f"## {scene_title(scene)}", "", f"{views['train']} views train, {views['validation']} validate, "
        f"{views['test']} test; references are {scene['references']}. Made with {options}.", ""]
    if "comparison" in scene:
        parts += ["### Foveated representations", "", comparison_table(scene["comparison"]),
                  "### Points per level", "", points_table(scene), curves_table(scene["level_curves"])]
    if "ablation" in scene:
        parts += ["### Ablation", "", "PSNR is of level 1, which foveated frames show in the fovea.", "",
                  ablation_table(scene["ablation"])]
    if "pruning" in scene:
        parts += ["### Pruning", "", PRUNING_NOTE, "", pruning_table(scene["pruning"])]
    return parts


def comparison_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The methods side by side, with the paper's numbers."""
    smfr = next(row for row in rows if row["method"] == labels.SMFR)
    base = labels.PAPER[labels.SMFR]

    def cells(row: Mapping[str, Any]) -> list[str]:
        frame, paper = row["frame"], labels.PAPER.get(row["method"])
        own = [row["method"], f"{row['storage_mb']:.3f}", f"{row['over_l1_percent']:+.1f} %",
               *(f"{1e5 * value:.2f}" for value in row["hvsq"]), f"{frame['entries']:,.0f}", f"{frame['cycles']:,.0f}",
               f"{smfr['frame']['cycles'] / frame['cycles']:.2f}"]
        if paper is None:
            return [*own, "", "", ""]
        return [*own, f"{paper['fps']:g} ({paper['fps'] / base['fps']:.2f})",
                f"{paper['storage_mb']:g} ({100 * (paper['storage_mb'] / base['storage_mb'] - 1):+.0f} %)",
                " / ".join(f"{value:g}" for value in paper["hvsq_e5"])]

    whole = table(
        ("method", "storage MB", "over L1", "HVSQ 1e-5 L1", "L2", "L3", "L4", "intersections/frame",
         f"{cycles_of(smfr['frame'])}, per frame", "speed, SMFR = 1", "paper: FPS (SMFR = 1)",
         "paper: MB (over SMFR)", "paper: HVSQ 1e-5"),
        map(cells, rows))
    return whole + windows_table(rows)


def windows_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """HVSQ of the levels on test views with each kind of windows, and how far it is above L1's on gate and test views. It is
    empty for reports from before there were kinds."""
    rows = [row for row in rows if "hvsq_by_kind" in row]
    if not rows:
        return ""

    def cells(row: Mapping[str, Any]) -> list[str]:
        above = [[100 * (value / hvsq[0] - 1) for value in hvsq[1:]] for hvsq in (row["hvsq_validation"], row["hvsq"])]
        return [
            row["method"],
            *(", ".join(f"{1e5 * value:.2f}" for value in row["hvsq_by_kind"][kind]) for kind in ("blocks", "box")),
            *(", ".join(f"{value:+.1f} %" for value in each) for each in above),
            ", ".join(f"{test - gate:+.1f}" for gate, test in zip(*above, strict=True)),
            ", ".join(f"{value:.2f}" for value in row["points_per_pixel"])]

    return "\n" + table(
        ("method", "HVSQ 1e-5 of L1 to L4, blocks", "box", "L2 to L4 over L1, gate views", "test views", "gate to test",
         "points a pixel"), map(cells, rows))


def ablation_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The effect of each technique."""
    dense = rows[0]

    def cells(row: Mapping[str, Any]) -> list[str]:
        frame, name = row["frame"], row["name"]
        size, speed = labels.PAPER_SIZE_PERCENT.get(name), labels.PAPER_SPEED.get(name)
        return [
            name, f"{row['points']:,}", f"{row['storage_mb']:.3f}", f"{100 * row['storage_mb'] / dense['storage_mb']:.1f} %",
            f"{frame['entries_per_tile']:.1f}", f"{frame['entries']:,.0f}", f"{frame['cycles']:,.0f}",
            f"{dense['frame']['entries'] / max(frame['entries'], 1):.2f}", f"{dense['frame']['cycles'] / frame['cycles']:.2f}",
            f"{row['psnr']:.2f}", f"{row['ssim']:.4f}", "" if speed is None else f"{speed:.1f}",
            "" if size is None else f"{size:g} %", *gate_cells(row, dense)]

    return table(
        ("model", "points of L1", "storage MB", "of dense", "intersections/tile", "per frame",
         f"{cycles_of(dense['frame'])}, per frame", "fewer intersections, times", "speed, dense = 1", "PSNR dB", "SSIM",
         "paper: speed", "paper: size", *gate_head(rows)), map(cells, rows))


def gate_head(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Heads of `gate_cells`; none for reports from before there were such columns."""
    return ("points a pixel", "PSNR of dense, gate views", "gate to test") if "psnr_gate" in rows[0] else ()


def gate_cells(row: Mapping[str, Any], dense: Mapping[str, Any]) -> list[str]:
    """Points a pixel, the share of the dense model's PSNR on the gate's views, and by how much that on test views differs."""
    if "psnr_gate" not in row:
        return []
    gate, test = (100 * row[key] / dense[key] for key in ("psnr_gate", "psnr"))
    return [f"{row['points_per_pixel']:.2f}", f"{gate:.2f} %", f"{test - gate:+.2f}"]


def points_table(scene: Mapping[str, Any]) -> str:
    """The points of each level, and the points that opacity enhancement saves."""
    shown = [row for row in scene["comparison"] if row["method"] in (labels.OURS, labels.PLAIN)]
    return table(
        ("model", "L1", "L2", "L3", "L4"),
        [*([row["method"], *(f"{count:,} ({share:.1f} %)" for count, share in zip(
            row["points"], row["points_percent"], strict=True))] for row in shown),
         ["the predecessor, bicycle", *(f"{share:g} %" for share in labels.PREDECESSOR_PERCENT)]]) + (
        "\nOpacity enhancement leaves " + ", ".join(
            f"{-share + 0.0:+.1f} % points in L{level}" for level, share in enumerate(scene["fewer_percent"], 1) if level > 1)
        + f" against training without it (the paper: up to {labels.PAPER_FEWER_PERCENT:g} % fewer in R3 and R4), both held "
        "to L1's HVSQ on the validation views.\n")


def curves_table(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """HVSQ against points during training."""
    return "Lowest HVSQ that training reached at a number of points, over L1's on the validation views:\n\n" + table(
        ("level", "model", "points kept", "points: HVSQ / target"),
        ((f"L{curve['level']}", method, f"{curve['kept']:,}", ", ".join(
            f"{points:,}: {hvsq:.3f}" for points, hvsq in zip(curve["points"], curve["hvsq"], strict=True)))
         for method, own in curves.items() for curve in own))


PRUNING_NOTE = (
    "From one dense model, with the same loop, interval and iterations; *ours* prunes under scale decay, as CE does where it "
    "has a row of its own, the others by their criterion and without. Everything is of the test views, but for *at equal "
    "PSNR*: the baseline's result against the cheapest look that our loop with the same gate had at no less PSNR, both on the "
    "gate's validation views. *Squares* are the intersections if each Gaussian were listed in all tiles that meet the square "
    "of three standard deviations around it, as in 3DGS, which published speed-ups count.")


def pruning_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows of gates and criteria, with the targets that each reaches."""
    own = own_criterion(rows)
    ours = {row["variant"]: row for row in rows if row["criterion"] == own and not row["tuned"]}

    def cells(row: Mapping[str, Any]) -> list[str]:
        targets = [] if row["criterion"] is None else (
            _own_targets(row) if row["equal"] is None else _against_ours(row, ours[row["variant"]]))
        return [
            _pruned_name(row, own), row["variant"] or "", f"{row['points']:,}", f"{row['points_percent']:.1f} %",
            f"{row['frame']['entries']:,.0f}", f"{row['cut']:.2f}", f"{row['frame']['cycles']:,.0f}", f"{row['psnr']:.2f}",
            f"{row['psnr_percent']:.2f} %", f"{row['ssim']:.4f}", f"{row['ssim_percent']:.2f} %", "; ".join(targets),
            *gate_cells(row, rows[0]), *square_cells(row)]

    return table(
        ("pruned by", "gate", "points", "of dense", "intersections/frame", "fewer than dense, times",
         f"{cycles_of(rows[0]['frame'])}, per frame", "PSNR dB", "of dense", "SSIM", "of dense", "targets",
         *gate_head(rows), *(("squares/frame", "fewer squares, times", "squares / exact") if "squares" in rows[0] else ())),
        map(cells, rows))


def square_cells(row: Mapping[str, Any]) -> list[str]:
    """The intersections by squares, how much fewer they are than the dense model's, and how many there are for an exact one.
    None for reports from before these were counted."""
    if "squares" not in row:
        return []
    return [f"{row['squares']:,.0f}", f"{row['cut_squares']:.2f}", f"{row['squares'] / max(row['frame']['entries'], 1):.2f}"]


def own_criterion(rows: Sequence[Mapping[str, Any]]) -> str | None:
    """The criterion of our loops, whose results alone are fine-tuned. Reports of before it was ours have the paper's there."""
    return next((row["criterion"] for row in rows if row["tuned"]), None)


def _pruned_name(row: Mapping[str, Any], ours: str | None) -> str:
    if row["criterion"] is None:
        return labels.DENSE
    name = labels.OURS if row["criterion"] == ours else labels.CRITERION_LABELS[row["criterion"]]
    return f"{name}, fine-tuned: L1" if row["tuned"] else name


def _own_targets(row: Mapping[str, Any]) -> list[str]:
    """The verdicts on one of our rows."""
    return [f"{asked} {reached(good)}" for asked, _, good in own_targets(row)]


def _against_ours(row: Mapping[str, Any], ours: Mapping[str, Any]) -> list[str]:
    """The comparison of ours with a baseline's row."""
    times = row["frame"]["entries"] / max(ours["frame"]["entries"], 1.0)
    asked, measured, good = equal_target(row)
    return [f"ours {times:.2f} times fewer at the same gate", f"{asked} {reached(good)}: {measured}"]


def latency_text(scene: Mapping[str, Any]) -> str:
    """The pruned versions of the dense model, and how their cycles follow points and intersections."""
    shown, (width, height) = scene["latency"], scene["latency"]["size"]
    whole = shown["versions"][0]
    cycles = cycles_of(whole["work"])

    def cells(version: Mapping[str, Any]) -> list[str]:
        work, rtl = version["work"], version["rtl"]
        return [
            labels.CRITERION_LABELS[version["criterion"]], f"{100 * version['removed']:.0f} %", f"{version['points']:,}",
            f"{work['entries_per_tile']:.1f}", f"{work['cycles']:,.0f}", "" if rtl is None else f"{rtl['cycles']:,}",
            f"{version['points'] / whole['points']:.3f}", f"{work['entries'] / max(whole['work']['entries'], 1):.3f}",
            f"{work['cycles'] / whole['work']['cycles']:.3f}",
            "" if rtl is None else f"{rtl['cycles'] / whole['rtl']['cycles']:.3f}"]

    return "\n".join([
        f"### {scene['scene']}, {width}x{height}", "",
        table(("removed by", "removed", "points", "intersections/tile", cycles, "RTL cycles", "points, of dense",
               "intersections, of dense", f"{cycles}, of dense", "RTL cycles, of dense"), map(cells, shown["versions"])),
        agreement_table(scene)])


def agreement_table(scene: Mapping[str, Any]) -> str:
    """How well cycles follow points and intersections."""
    return table(("", "Pearson r", "off"), (
        [f"{CYCLES[name]} against {'intersections' if quantity == 'entries' else quantity}",
         f"{of['pearson']:.4f}", f"{of['off']:.3f}"]
        for name, by in scene["latency"]["proportionality"].items() for quantity, of in by.items()))
