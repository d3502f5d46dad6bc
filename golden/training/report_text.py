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
        _table(("stage", "level", "points", "intersections/frame", "PSNR dB", "SSIM", "HVSQ 1e-5", "iterations", "seconds"),
               ((r["stage"], r["level"], f"{r['points']:,}", f"{r['entries']:,.0f}", f"{r['psnr']:.2f}", f"{r['ssim']:.4f}",
                 _hvsq(r["hvsq"]), f"{r['iterations']:,}", f"{r['seconds']:.0f}") for r in report["stages"])),
        "## Levels", "", "HVSQ of whole frames at each level's pooling. The target is the HVSQ of L1.", "",
        _table(("level", "points", "of L1", "pooling px", "HVSQ 1e-5, test", "validation", "target", "above target"),
               ((f"L{r['level']}", f"{r['points']:,}", f"{100 * r['share']:.1f} %", f"{pooling:.2f}", _hvsq(r["hvsq_test"]),
                 _hvsq(r["hvsq_validation"]), _hvsq(r["target_validation"]), f"{r['excess_percent']:+.1f} %")
                for r, pooling in zip(report["levels"], report["pooling_px"], strict=True))),
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
    doubtful, psnr = report["views"]["doubtful"], report["psnr_dense_well_posed"]
    if not doubtful:
        return ""
    judged = "" if psnr is None else f"; dense {psnr:.2f} dB on the other test views"
    return f" The poses of {len(doubtful)} views are in doubt, so these views neither train nor validate{judged}."


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
