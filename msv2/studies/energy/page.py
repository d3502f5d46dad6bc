"""The energy report as a page and as a picture."""

from __future__ import annotations

from pathlib import Path

from msv2.studies.energy.frame import CHIP, CLOCK_TREE_SHARE, WIRE_SHARE
from msv2.studies.energy.table import Table

OTHERS = (
    {"design": "129FPS (2026)", "node": "28 nm, 800 MHz", "frame": "1920x1080", "mj_per_frame": 0.219 / 129 * 1e3,
     "source": "0.219 W at 129 frames/s; chip only",
     "differs": "node; a model compressed 51.6 times (-0.74 dB); a chip, with wires and a clock tree"},
)
"""Published energies of a frame, with the reasons why they are not like for like."""

_COLUMNS = (*CHIP, "dram", "assumed")
_SHOWN = 9


def as_markdown(content: dict[str, object], table: Table) -> str:
    """The page as Markdown. Every number in it comes from `content` or `table`."""
    lines = [
        "# Energy of a frame", "",
        f"Commit {content['commit']}; operations measured at {content['measured_at']} ({table.node}), {table.scaling}. "
        "What the columns are: [docs/energy.md](../docs/energy.md).", "",
        "| frame | work by | machine | points | entries | ops | cycles | chip, mJ | DRAM, mJ | assumed, mJ | all, mJ | "
        "chip, mW | frames/s |",
        "|---|---|---|" + "---:|" * 10]
    for frame in content["frames"]:
        counts = frame["counts"]
        lines.append(
            f"| {_name(frame)} | {frame['work']} | {frame['config']} | {counts['points']:,} | {counts['entries']:,} | "
            f"{counts['ops']:,} | {frame['cycles']:,} | {frame['chip_mj']:.3f} | {frame['dram_mj']:.3f} | "
            f"{frame['assumed_mj']:.3f} | {frame['total_mj']:.3f} | {frame['chip_mw']:.0f} | {frame['frames_per_s']:.0f} |")
    lines += ["", f"Assumed: wires are {WIRE_SHARE:g} of the load that pins are, a clock tree takes {CLOCK_TREE_SHARE:g} of "
              "what its pins take; no placement is made.", "",
              "Published, not like for like:", "", "| design | node | frame | mJ | from | differs |",
              "|---|---|---|---:|---|---|"]
    lines += [f"| {o['design']} | {o['node']} | {o['frame']} | {o['mj_per_frame']:.2f} | {o['source']} | {o['differs']} |"
              for o in content["others"]]
    for frame in content["frames"]:
        lines += ["", f"## {_name(frame)}", "",
                  f"| unit | {', µJ | '.join(_COLUMNS)}, µJ | all, µJ | pJ an entry |", "|---|" + "---:|" * (len(_COLUMNS) + 2)]
        ordered = sorted(frame["by_unit_mj"].items(), key=lambda item: -sum(item[1].values()))
        for unit, parts in ordered:
            cells = " | ".join(f"{1e3 * parts[part]:.2f}" if parts[part] else "" for part in _COLUMNS)
            lines.append(f"| {unit} | {cells} | {1e3 * sum(parts.values()):.2f} | {frame['pj_per_entry'][unit]:.1f} |")
    lines += ["", "## What an operation costs", "", f"At {table.node}, unscaled; memories are counted apart, by access.", "",
              "| unit | operation | pJ | of it nets | clock, pJ a cycle | leakage, mW | measured by |",
              "|---|---|---:|---:|---:|---:|---|"]
    lines += [f"| {u.name} | {u.operation} | {u.dynamic_pj:.3f} | {u.switching_pj:.3f} | {u.clock_pj:.3f} | "
              f"{u.leakage_mw:.4f} | {u.source} |" for u in table.units]
    lines += ["", "## Memories of the chip and beside it", "", "| what | pJ | node | source | scaling |",
              "|---|---:|---|---|---|"]
    seen = {}
    for row in (row for frame in content["frames"] for row in frame["rows"] if row["part"] in ("sram", "dram")):
        seen.setdefault(row["operation"], row)
    for row in seen.values():
        made = content["coefficients"][row["coefficient"]]
        cells = row["operation"], f"{row['coefficient_pj']:.3f}", made["node"], made["source"], made["scaling"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _name(frame: dict[str, object]) -> str:
    gaze = f", {frame['levels']} levels" if frame["gaze"] else ""
    return f"{frame['scene']} {frame['size'][0]}x{frame['size'][1]}{gaze}"


def plot(frames: list[dict[str, object]], path: Path) -> bool:
    """Draws bars of the frames' energies by part, and of the chip's by unit. Returns False without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return False
    matplotlib.use("Agg")
    from matplotlib import pyplot

    chip = [{unit: sum(parts[part] for part in CHIP) for unit, parts in frame["by_unit_mj"].items()} for frame in frames]
    largest = sorted(chip[0], key=lambda unit: -sum(one.get(unit, 0.0) / sum(one.values()) for one in chip))[:_SHOWN]
    shares = [{unit: one.get(unit, 0.0) / sum(one.values()) for unit in largest} for one in chip]
    shares = [{**one, "others": 1 - sum(one.values())} for one in shares]
    figure, axes = pyplot.subplots(1, 2, figsize=(15, 1.8 + 0.5 * len(frames)))
    labels = [f"{_name(frame)}\n{frame['work']}" for frame in frames]
    for axis, rows, title in ((axes[0], [frame["by_part_mj"] for frame in frames], "mJ a frame, 16 nm; DRAM as it is"),
                              (axes[1], shares, "share of the chip's energy, without what is assumed")):
        left = [0.0] * len(frames)
        for number, name in enumerate(rows[0]):
            widths = [row[name] for row in rows]
            axis.barh(labels, widths, left=left, label=name, color=pyplot.get_cmap("tab20")(number))
            left = [a + b for a, b in zip(left, widths, strict=True)]
        axis.invert_yaxis()
        axis.set_title(title)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    axes[1].set_yticks([])
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return True
