"""The energy report as a page and as a picture."""

from __future__ import annotations

from pathlib import Path

from msv2.studies.energy.dram import GROUPS
from msv2.studies.energy.estimates import estimates
from msv2.studies.energy.frame import CHIP, DRAM_UNIT
from msv2.studies.energy.supertiles import super_table
from msv2.studies.energy.table import Table
from msv2.studies.memory import MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.picture import find_pyplot, save_figure
from spec.config import V3
from spec.memory import BEAT_BYTES

OTHERS = (
    {"design": "129FPS (2026)", "node": "28 nm, 800 MHz", "frame": "1920x1080", "mj_per_frame": 0.219 / 129 * 1e3,
     "source": "0.219 W at 129 frames/s; chip only",
     "differs": "node; a model compressed 51.6 times (-0.74 dB); a chip, with wires and a clock tree"},
)
"""Published energies of a frame, with the reasons why they are not like for like."""

_BOUND = ("The ideal memory is a bound: it has no rows, no refresh and no turns of its bus, so that a frame takes fewer "
          "cycles. DRAM's energy with it lacks activates and refreshes, which are not counted.")

_COLUMNS = (*CHIP, "dram", "assumed")
_SHOWN = 9


def as_markdown(content: dict[str, object], energies: Table) -> str:
    """The page. Every number on it comes from `content`, `energies` or the kept estimates."""
    known = estimates()
    lines = [
        "# Energy of a frame", "",
        f"Commit {content['commit']}; operations measured at {content['measured_at']} ({energies.node}), {energies.scaling}. "
        "What the columns are: [docs/energy.md](../docs/energy.md).", "",
        table(("frame", "memory", "work by", "machine", "points", "entries", "ops", "cycles", "chip, mJ",
               "chip by Nangate45, mJ", "DRAM, mJ", "assumed, mJ", "all, mJ", "all, from to", "chip, mW", "frames/s"),
              map(_summary, content["frames"]), left=4), "", _BOUND, "", _anchors(), "",
        "## DRAM by what it does", "",
        table(("frame", "memory", "work by", *(f"{name}, mJ" for name in GROUPS), "all, mJ", "pJ a bit"),
              map(_dram, content["frames"]), left=3)]
    lines += ["", "## Assumed and published", "",
              "Assumed: wires and clock tree of the whole machine are as those of five placed units "
              f"([wires.md](../reports/wires.md)): wires are {known.wires.value:.2f} of the load that pins are, a clock "
              f"tree takes {known.clock_tree.value:.2f} of what its pins and the cells behind them take.", "",
              "Published, not like for like:", "",
              table(("design", "node", "frame", "mJ", "from", "differs"),
                    [(o["design"], o["node"], o["frame"], f"{o['mj_per_frame']:.2f}", o["source"], o["differs"])
                     for o in content["others"]], left=3, words=("from", "differs"))]
    for frame in (frame for frame in content["frames"] if frame["memory"] == content["frames"][0]["memory"]):
        ordered = sorted(frame["by_unit_mj"].items(), key=lambda item: -sum(item[1].values()))
        lines += ["", f"## {_name(frame)}, {MEMORY_NAMES[frame['memory']]}", "",
                  table(("unit", *(f"{name}, µJ" for name in _COLUMNS), "all, µJ", "pJ an entry"),
                        [(unit, *(f"{1e3 * parts[part]:.2f}" if parts[part] else "" for part in _COLUMNS),
                          f"{1e3 * sum(parts.values()):.2f}", f"{frame['pj_per_entry'][unit]:.1f}")
                         for unit, parts in ordered], left=1)]
    for title, units in (("What an operation costs", energies.units),
                         (f"What an operation costs on `{V3.name}`", super_table(energies).units)):
        lines += ["", f"## {title}", "", f"At {energies.node}, unscaled; memories are counted apart, by access.", "",
                  table(("unit", "operation", "pJ", "of it nets", "clock, pJ a cycle", "leakage, mW", "measured by"),
                        [(u.name, u.operation, f"{u.dynamic_pj:.3f}", f"{u.switching_pj:.3f}", f"{u.clock_pj:.3f}",
                          f"{u.leakage_mw:.4f}", u.source) for u in units], left=2, words=("measured by",))]
    lines += ["", "## Memories of the chip and beside it", ""]
    head = ("what", "pJ", "node", "source", "scaling")
    cells: dict[str, tuple[str, ...]] = {}
    for price in content["prices"]:
        if price["part"] in ("sram", "dram"):
            cells.setdefault(price["operation"], (price["operation"], f"{price['coefficient_pj']:.3f}",
                                                  *(price[key] for key in head[2:])))
    return "\n".join([*lines, table(head, cells.values(), left=1, words=head[2:])]) + "\n"


def _dram(frame: dict[str, object]) -> tuple[str, ...]:
    counts, absent = frame["counts"], {"activates": "activates", "refreshes": "refresh"}
    unknown = {absent[name] for name in frame["dram_not_counted"]}
    bits = 8 * BEAT_BYTES * (counts["read_beats"] + counts["write_beats"])
    return (_name(frame), MEMORY_NAMES[frame["memory"]], frame["work"],
            *("not counted" if name in unknown else f"{frame['by_dram_mj'][name]:.3f}" for name in GROUPS),
            f"{frame['dram_mj']:.3f}", f"{1e9 * frame['dram_mj'] / max(bits, 1):.1f}")


def _anchors() -> str:
    """What the second library says."""
    anchor = estimates().anchor
    return (
        "**Two anchors.** Operations are measured in ASAP7 and scaled to 16 nm from 7 nm. Scaled from 45 nm, Nangate45 says "
        f"{anchor.value:.2f} of that for the same units ({anchor.low:.2f} to {anchor.high:.2f}; "
        "[energy_anchors.md](../reports/energy_anchors.md)), which the column *chip by Nangate45* takes for all logic; "
        "memories and leakage stay. Which of the two a chip at 16 nm would have is not known. *From to* has both, with the "
        "smallest and largest shares of wires and clock tree of a placed unit. DRAM's currents are those of data sheets and "
        "have no range.")


def _summary(frame: dict[str, object]) -> tuple[str, ...]:
    counts = frame["counts"]
    return (_name(frame), MEMORY_NAMES[frame["memory"]], frame["work"], frame["config"],
            *(f"{counts[key]:,}" for key in ("points", "entries", "ops")), f"{frame['cycles']:,}",
            *(f"{frame[key]:.3f}" for key in ("chip_mj", "other_chip_mj", "dram_mj", "assumed_mj", "total_mj")),
            "{:.3f} to {:.3f}".format(*frame["range_mj"]), f"{frame['chip_mw']:.0f}", f"{frame['frames_per_s']:.0f}")


def _name(frame: dict[str, object]) -> str:
    gaze = f", {frame['levels']} levels" if frame["gaze"] else ""
    return f"{frame['scene']} {frame['size'][0]}x{frame['size'][1]}{gaze}"


def plot(frames: list[dict[str, object]], path: Path) -> bool:
    """Draws bars of the frames' energies by part, of DRAM's by what it does, and of the chip's by unit. Returns False without
    matplotlib."""
    pyplot = find_pyplot()
    if pyplot is None:
        return False
    chip = [{unit: sum(parts[part] for part in CHIP) for unit, parts in frame["by_unit_mj"].items()
             if not unit.startswith(DRAM_UNIT)} for frame in frames]
    largest = sorted(chip[0], key=lambda unit: -sum(one.get(unit, 0.0) / sum(one.values()) for one in chip))[:_SHOWN]
    shares = [{unit: one.get(unit, 0.0) / sum(one.values()) for unit in largest} for one in chip]
    shares = [{**one, "others": 1 - sum(one.values())} for one in shares]
    figure, axes = pyplot.subplots(1, 3, figsize=(15, max(3.2, 1.8 + 0.5 * len(frames))))
    labels = [f"{_name(frame)}\n{frame['work']}, {MEMORY_NAMES[frame['memory']]}" for frame in frames]
    for axis, rows, title in ((axes[0], [frame["by_part_mj"] for frame in frames], "mJ a frame, 16 nm; DRAM as it is"),
                              (axes[1], [frame["by_dram_mj"] for frame in frames], "DRAM, mJ a frame"),
                              (axes[2], shares, "share of the chip's energy, without what is assumed")):
        left = [0.0] * len(frames)
        for number, name in enumerate(rows[0]):
            widths = [row[name] for row in rows]
            axis.barh(labels, widths, left=left, label=name, color=pyplot.get_cmap("tab20")(number))
            left = [a + b for a, b in zip(left, widths, strict=True)]
        axis.margins(y=0.01)
        axis.invert_yaxis()
        axis.set_title(title)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    for axis in axes[1:]:
        axis.set_yticks([])
    figure.tight_layout()
    save_figure(figure, path)
    return True
