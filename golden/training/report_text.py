"""Writes report.md, which shows the content of report.json for people. It holds nothing that is not in report.json."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def markdown(report: Mapping[str, Any]) -> str:
    """The text of report.md."""
    width, height = report["size"]
    views = report["views"]
    parts = [
        f"# {report['scene']}: a foveated model", "",
        f"Frames are {width}x{height}. {views['train']} views train, {views['validation']} validate, {views['test']} test. "
        f"The references are {report['references']}. " + _options(report["options"]), "",
        _summary(report), "",
        _pictures(report["pictures"]),
        "## Stages", "",
        "Each row measures a stage's model on whole frames of the test views. HVSQ pools as the stage's level does.",
        "",
        *_stages(report["stages"]),
        *_levels(report),
        _storage(report["storage"]), "",
        "## Regions", "",
        "HVSQ in 1e-5 of frames with the gaze in the centre. Each pixel pools by its eccentricity; means over the test views.",
        "",
        _table(("region", "from", "of the frame", "dense", "L1 everywhere", "foveated"),
               ((f"R{r['region']}", f"{r['start_deg']:g} deg", f"{100 * r['pixels']:.1f} %", _hvsq(r["hvsq_dense"]),
                 _hvsq(r["hvsq_l1"]), _hvsq(r["hvsq_foveated"])) for r in report["regions"])),
        *_machine(report),
        "## Training", "", f"![loss, PSNR and points over iterations]({report['curves']})", "",
        "Seconds: " + ", ".join(f"{name} {seconds:.0f}" for name, seconds in report["seconds"].items()) + ".", ""]
    return "\n".join(parts)


def _stages(rows: list[Mapping[str, Any]]) -> list[str]:
    dense = rows[0]

    def cells(row: Mapping[str, Any]) -> tuple[object, ...]:
        gate, test = (100 * row[key] / dense[key] for key in ("psnr_gate", "psnr"))
        return (row["stage"], row["level"], f"{row['points']:,}", f"{row['points_per_pixel']:.2f}", f"{row['entries']:,.0f}",
                f"{row['psnr']:.2f}", f"{row['ssim']:.4f}", f"{gate:.1f} %", f"{test:.1f} %", f"{test - gate:+.1f}",
                _hvsq(row["hvsq"]), f"{row['iterations']:,}", f"{row['seconds']:.0f}")

    return [
        "*Of dense* is PSNR in percent of the dense model's, on the validation views and on the test views; *gate to test* is "
        "the difference.", "",
        _table(("stage", "level", "points", "a pixel", "intersections/frame", "PSNR dB", "SSIM", "of dense, gate", "test",
                "gate to test", "HVSQ 1e-5", "iterations", "seconds"), map(cells, rows))]


def _levels(report: Mapping[str, Any]) -> list[str]:
    def cells(row: Mapping[str, Any], pooling: float) -> tuple[object, ...]:
        return (f"L{row['level']}", f"{row['points']:,}", f"{row['points_per_pixel']:.2f}", f"{100 * row['share']:.1f} %",
                f"{pooling:.2f}", _hvsq(row["hvsq_validation"]), f"{row['excess_percent']:+.1f} %", _hvsq(row["hvsq_test"]),
                f"{row['excess_test_percent']:+.1f} %", f"{row['excess_test_percent'] - row['excess_percent']:+.1f}",
                _hvsq(row["hvsq_test_blocks"]), _hvsq(row["hvsq_test_box"]))

    poses = report["poses"]
    read = "" if poses["psnr_l1_to_dense"] is None else (
        f" Gates also read {poses['count']} interpolated poses, on which L1 has {poses['psnr_l1_to_dense']:.2f} dB against the "
        "dense model.")
    return [
        "## Levels", "", f"HVSQ (1e-5) of whole frames at each level's pooling, over {report['pooling']} where nothing else is "
        f"said, and how far it is above that of L1.{read}", "",
        _table(("level", "points", "a pixel", "of L1", "pooling px", "HVSQ, validation", "above L1", "test", "above L1",
                "gate to test", "test, blocks", "test, box"),
               (cells(row, pooling) for row, pooling in zip(report["levels"], report["pooling_px"], strict=True)))]


def _options(options: Mapping[str, Any]) -> str:
    given = ", ".join(f"{name} {value}" for name, value in options.items() if value is not None)
    return f"Made with {given}."


def _summary(report: Mapping[str, Any]) -> str:
    entries, points = report["entries_per_frame"], report["points"]
    lines = [
        f"- PSNR on test views: dense {report['psnr_dense']:.2f} dB, L1 {report['psnr_l1']:.2f} dB "
        f"({100 * report['psnr_l1'] / report['psnr_dense']:.1f} %)." + _doubtful(report),
        f"- Points: dense {points['dense']:,}, levels {', '.join(f'{count:,}' for count in points['levels'])}.",
        f"- Intersections per frame: dense {entries['dense']:,.0f}, " + ", ".join(
            f"{'L1 everywhere' if name == 'l1' else name} {value:,.0f} (1/{entries['dense'] / max(value, 1):.2f})"
            for name, value in entries.items() if name != "dense") + "."]
    if report["quantised_loss_db"] is not None:
        lines.append(f"- Quantisation to the machine's formats costs {report['quantised_loss_db']:.4f} dB.")
    times = ", ".join(f"{count} times in {stage}" for stage, count in report.get("narrowed", {}).items() if count)
    lines.append(f"- Splats that were too wide for the machine to place were narrowed {times or 'nowhere'}. "
                 f"{report['misplaced']} of them are left in the frames of the test views.")
    return "\n".join(lines)


def _doubtful(report: Mapping[str, Any]) -> str:
    """The sentence about views whose poses are in doubt."""
    doubtful = report["views"]["doubtful"]
    if not doubtful:
        return ""
    return (f" The poses of {len(doubtful)} views are in doubt, so these views neither train nor validate nor count in a mean; "
            f"over all test views dense has {report['psnr_dense_all']:.2f} dB and L1 {report['psnr_l1_all']:.2f} dB.")


def _pictures(pictures: Mapping[str, str]) -> str:
    """Tables of one row each: frames, levels, regions, as far as there are any."""
    levels = [name for name in pictures if name.startswith("level ")]
    rows = (("reference", "dense", "foveated", "difference"), levels, ("regions",))
    lines = []
    for names in ([name for name in row if name in pictures] for row in rows):
        if names:
            lines += ["| " + " | ".join("difference x4" if name == "difference" else name for name in names) + " |",
                      "|---" * len(names) + "|",
                      "| " + " | ".join(f"![{name}]({pictures[name]})" for name in names) + " |", ""]
    return "\n".join(lines)


def _storage(storage: Mapping[str, float]) -> str:
    return (f"Storage: L1 {storage['level1']:,} bytes, other levels {storage['versions']:,}, quality bounds "
            f"{storage['bounds']:,}; in all {storage['total']:,}, {storage['overhead_percent']:+.2f} % over L1.")


def _machine(report: Mapping[str, Any]) -> list[str]:
    machine = report["machine"]
    if machine is None:
        return ["## Machine", "", "Frames of this size are wider than the machine's rows and were not rendered there.", ""]
    rows = [("L1 everywhere", machine["psnr_float"], machine["psnr_quantised"])]
    if machine["foveated_psnr_float"] is not None:
        rows.append(("foveated", machine["foveated_psnr_float"], machine["foveated_psnr_quantised"]))
    return [
        "## Machine", "",
        f"PSNR against the references of {len(machine['views'])} test views: the float64 oracle, and the integer golden "
        "renderer, which the RTL equals bit for bit.", "",
        _table(("frame", "float64 dB", "integer dB", "loss dB"),
               ((name, f"{left:.3f}", f"{right:.3f}", f"{left - right:.4f}") for name, left, right in rows))]


def _hvsq(value: float) -> str:
    return f"{1e5 * value:.2f}"


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    head = list(head)
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(map(str, row)) + " |" for row in rows), ""])
