"""The figure of the area report."""

from __future__ import annotations

from pathlib import Path

from msv2.studies.picture import find_pyplot, save_figure


def draw(report: dict, path: Path) -> None:
    """Draws three bar charts into a PNG file: the parts beside the paper's, the groups of units, and all builds."""
    pyplot = find_pyplot()
    figure, (parts, groups, builds) = pyplot.subplots(1, 3, figsize=(12, 4.2), gridspec_kw={"width_ratios": [1, 1.7, 1.7]})
    bottom = [0.0, 0.0]
    for part in report["split"]:
        heights = [report["paper"]["split"][part], report["split"][part]]
        parts.bar(["the paper", "ours"], heights, bottom=bottom, label=part)
        bottom = [base + height for base, height in zip(bottom, heights, strict=True)]
    parts.set_title("parts")
    parts.set_ylabel("mm² at 16 nm")
    parts.set_ylim(top=1.3 * max(bottom))
    parts.legend(loc="upper right", fontsize=8)
    found = report["builds"]["1ghz"]["groups"]
    names = list(found)[::-1]
    logic, memory = ([found[name][key] / 1e6 for name in names] for key in ("logic_um2_16nm", "memory_um2_16nm"))
    groups.barh(names, logic, label="logic")
    groups.barh(names, memory, left=logic, label="memories")
    groups.margins(x=0.05)
    groups.set_title("groups")
    groups.set_xlabel("mm² at 16 nm")
    groups.legend()
    names = list(report["builds"])[::-1]
    labels = [f"{name}: {report['builds'][name]['technology']}, {report['builds'][name]['clock_ps']:,.0f} ps" for name in names]
    logic = [report["builds"][name]["mm2_16nm_logic"] for name in names]
    builds.barh(labels, logic, label="logic")
    memory = [report["builds"][name]["mm2_16nm"] - base for name, base in zip(names, logic, strict=True)]
    builds.barh(labels, memory, left=logic, label="memories")
    builds.set_title("builds, scaled to 16 nm")
    builds.set_xlabel("mm²")
    figure.text(0.995, 0.005, f"{report['commit']}, {report['builds']['1ghz']['config']}", ha="right", fontsize=7)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
