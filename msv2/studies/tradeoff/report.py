"""Writes the results as JSON, as CSV for every picture, as Markdown and as one HTML page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from msv2.studies.page import table, write_html, write_page
from msv2.studies.record import write_report
from msv2.studies.tradeoff.choose import ASSUMED_PSNR_DB, BUDGETS
from msv2.studies.tradeoff.knobs import CONSTANTS, DEFAULT, PRESET
from spec.config import PAPER, PRESETS, AcceleratorConfig
from spec.constants import REGION_START_DEG

Content = Mapping[str, Any]

PICTURES = ("machine", "simulation", "training")

COSTS = ("cycles", "times the default's speed", "frames/s at 1 GHz", "chip, mJ", "DRAM, mJ", "area, mm²", "bits of all formats",
         "loss, dB", "HVSQ")


BUILDS = {"1ghz": PAPER.with_(stereo=True), "mono": PAPER, **PRESETS}
"""Machines whose areas are in reports/area.json, by the names of their builds there."""


def known_areas(path: Path) -> dict[AcceleratorConfig, float]:
    """Area in mm^2 at 16 nm of the machines of BUILDS in reports/area.json, all named as PAPER is. Empty if the report is
    missing."""
    builds = json.loads(path.read_text())["builds"] if path.is_file() else {}
    return {config.with_(name=PAPER.name): builds[name]["mm2_16nm"] for name, config in BUILDS.items() if name in builds}


def write(content: Content, out: Path, name: str, configuration: object = None, inputs: Sequence[Path | str] = ()) -> None:
    """Writes NAME.json, NAME.md and NAME.html, and for each of PICTURES a CSV file and, if matplotlib is installed, a PNG file.

    Args:
        content: the content of the report.
        out: an existing folder.
        name: the name of the files.
        configuration, inputs: the configuration and the inputs for the provenance.
    """
    write_report(out / f"{name}.json", content, ["msv2.studies.tradeoff.study"], configuration, inputs)
    tables = {"machine": machinetable(content["machine"]), "simulation": [dict(r) for r in content["simulation"]["rows"]],
              "training": trainingtable(content["training"])}
    for picture in PICTURES:
        write_page(out / f"{name}_{picture}.csv", as_csv(tables[picture]))
    drawn = {}
    if find_spec("matplotlib") is not None:
        from msv2.studies.tradeoff import plot

        for picture in PICTURES:
            if tables[picture]:
                drawn[picture] = out / f"{name}_{picture}.png"
                plot.save(picture, content, drawn[picture])
    text = as_markdown(content, {picture: path.name for picture, path in drawn.items()})
    write_page(out / f"{name}.md", text)
    write_html(out / f"{name}.html", f"What accuracy costs: {content['scene']}", text, drawn.values())


def machinetable(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows in flat form, with one number per column."""
    out = []
    for row in rows:
        flat = {k: v for k, v in row.items() if not isinstance(v, list | dict)}
        for key, values in (("hvsq", row.get("hvsq_regions")), ("ring_psnr_db", row.get("ring_psnr_db")),
                            ("ring_max_error", row.get("ring_max_error"))):
            for start, value in zip(REGION_START_DEG, values or (), strict=False):
                flat[f"{key}_{start:g}deg"] = value
        flat["broken"] = " ".join(row["broken"])
        flat["parts"] = "; ".join(" ".join(part) for part in row["parts"])
        out.append(flat)
    return out


def trainingtable(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A table with one row for each stage of the training."""
    return [{"scene": run["scene"], "variant": run["variant"], "size": "x".join(map(str, run["size"])), **stage}
            for run in runs for stage in run["stages"]]


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as CSV, with columns in the order in which they first appear."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _cell(value: object, form: str, scale: float = 1.0) -> str:
    return "-" if value is None else format(value * scale if scale != 1.0 else value, form)


def _area(row: Mapping[str, Any]) -> str:
    return "unknown" if row["area_mm2"] is None else f"{row['area_mm2']:.2f}"


def _what(row: Mapping[str, Any]) -> str:
    if row["knob"] == DEFAULT:
        return "the default"
    return ", ".join(" ".join(part) for part in row["parts"]) or f"{row['knob']} {row['value']}"


def recommendation(content: Content) -> str:
    """A table of the fastest setting for each budget."""
    rows = []
    for budget in BUDGETS:
        row = content["recommended"][budget.name]
        if row is None:
            rows.append([budget.name, "none", *["-"] * len(COSTS)])
            continue
        rows.append([budget.name, _what(row), *_costs(row)])
    return table(["loss accepted", "fastest setting", *COSTS], rows)


def presets(content: Content) -> str:
    """A table of the default machine and the presets."""
    rows = []
    for row in content["machine"]:
        if row["knob"] in (DEFAULT, PRESET) and not row.get("error"):
            worst = f"{row['worst_error_255']:.2f}" + (f" **breaks {len(row['broken'])}**" if row["broken"] else "")
            rows.append(["the default" if row["knob"] == DEFAULT else f"`{row['value']}`", *_costs(row),
                         f"{row['psnr_oracle_db']:.2f}", worst])
    return table(["machine", *COSTS, "PSNR oracle, dB", "worst hard case, /255"], rows)


def _costs(row: Mapping[str, Any]) -> list[str]:
    """The cells for the columns COSTS."""
    return [f"{row['cycles']:,.0f}", f"{row['speedup']:.2f}", f"{row['fps']:,.0f}", f"{row['chip_mj']:.4f}",
            f"{row['dram_mj']:.4f}", _area(row), str(row["word_bits"]), _cell(row["loss_db"], "+.4f"),
            _cell(row["hvsq_change"], "+.2%")]


def _machine_lines(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = []
    for row in rows:
        name = (("**" if row["pareto"] else "") + _what(row) + ("**" if row["pareto"] else ""))
        stable = f"{row['worst_error_255']:.2f}" + (f" **breaks {len(row['broken'])}**" if row["broken"] else "")
        if row.get("error"):
            cells.append([name, *["-"] * 11, stable + f"; cannot be: {row['error']}"])
            continue
        cells.append([
            name, f"{row['cycles']:,.0f}", f"{row['fps']:,.0f}", f"{row['chip_mj']:.4f}", f"{row['dram_mj']:.4f}", _area(row),
            _cell(row["psnr_photo_db"], ".3f"), _cell(row["ssim_photo"], ".4f"), _cell(row["loss_db"], "+.4f"),
            f"{row['psnr_oracle_db']:.2f}", _cell(row["hvsq"], ".3f", 1e5), _cell(row["hvsq_change"], "+.2%"), stable])
    return table(["setting", "cycles", "frames/s", "chip, mJ", "DRAM, mJ", "area, mm²", "PSNR photo, dB", "SSIM", "loss, dB",
                   "PSNR oracle, dB", "HVSQ, 1e-5", "HVSQ change", "worst hard case, /255"], cells)


def _ring_lines(rows: Sequence[Mapping[str, Any]]) -> str:
    names = [f"from {start:g}°" for start in REGION_START_DEG]
    cells = [[_what(row), *(_cell(v, ".2f") for v in row["ring_psnr_db"]), *(_cell(v, ".3f", 1e5) for v in row["hvsq_regions"])]
             for row in rows if not row.get("error")]
    return table(["setting", *(f"PSNR oracle {n}" for n in names), *(f"HVSQ {n}" for n in names)], cells)


def _broken_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    return [f"- {_what(row)}: {name}: {why}" for row in rows for name, why in list(row["broken"].items())[:3]]


def _simulation_lines(content: Content) -> str:
    cells = []
    for row in content["simulation"]["rows"]:
        error = _cell(row["cycle_error"], "+.2%") + (f" ({row['cycle_error_of']})" if row.get("cycle_error_of") else "")
        cells.append([row["name"], row["what"], f"{1e3 * row['wall_s']:,.1f}", f"{row['psnr_oracle_db']:.2f}",
                      f"{255 * row['max_abs_error']:.2f}", _cell(row["cycles"], ",.0f"), error])
    return table(["renderer", "what it is", "wall time, ms", "PSNR oracle, dB", "worst error, /255", "cycles", "cycle error"],
                  cells)


def _training_lines(content: Content) -> str:
    cells = [[f"{row['scene']}-{row['variant']}, {row['size']}", row["stage"], f"{row['iterations']:,}",
              f"{row['seconds']:,.0f}", f"{row['points']:,}", f"{row['entries']:,.0f}", f"{row['psnr']:.2f}",
              f"{row['ssim']:.4f}", _cell(row["hvsq"], ".3f", 1e5)] for row in trainingtable(content["training"])]
    if not cells:
        return "No finished run was found."
    return table(["run", "stage", "iterations so far", "seconds so far", "points", "entries", "PSNR, dB", "SSIM",
                   "HVSQ, 1e-5"], cells)


def as_markdown(content: Content, pictures: Mapping[str, str]) -> str:
    """The page as Markdown; every number in it comes from `content`."""
    judged = ("the photographs" if content["photographs"] else
              f"assumed photographs from which the float64 renderer is {ASSUMED_PSNR_DB:g} dB away (there are none here; "
              "errors of arithmetic are taken as uncorrelated with the model's)")
    rows = content["machine"]

    def shown(name: str) -> list[str]:
        return ["", f"![{name}]({pictures[name]})"] if name in pictures else []

    lines = [
        "# What accuracy costs in time", "",
        f"Made by `make tradeoff`; [docs/tradeoff.md](../docs/tradeoff.md) explains it. {content['scene']}, {content['size']}, "
        f"{content['views']} views, {content['points']:,} points, levels {content['levels']}. Losses are against {judged}.", "",
        "## Recommended", "", recommendation(content), "",
        "The fastest setting of one eye within a loss that breaks no hard case and that the RTL has; settings within 0.2 % of "
        "each other's cycles are as fast, and the one with fewer bits is taken, of as many the one with fewer harmonics. "
        "Energy does not know of word lengths: only of the work and the cycles. Area is that of the paper's machine, where it "
        "is known.",
        "", "## Presets", "", presets(content), "",
        "Machines of `spec.config.CONFIGS`: " + ", ".join(
            f"`{preset}` is the recommendation for {budget}" for preset, budget in content["presets"].items())
        + " on the embedded scene, and the machine itself has no more harmonics.", "",
        "## The machine", *shown("machine"), "",
        "Bold: on the frontier of cycles and loss. Frames of two eyes are judged by the second eye, and count their loss from "
        "both rendered. A setting **breaks** a hard case where the case's expectation or bound, which the default meets, is "
        "missed. "
        f"Not swept, as they are constants of the semantics and no machine's parameters: {', '.join(CONSTANTS)}.", "",
        _machine_lines(rows), "", "By eccentricity ring:", "", _ring_lines(rows), "",
        "What breaks (at most three of a setting):", "", *(_broken_lines(rows) or ["nothing"]), "",
        "## The simulation", *shown("simulation"), "",
        f"{content['simulation']['size']}, {content['simulation']['config']}.", "", _simulation_lines(content), "",
        "## The training", *shown("training"), "", _training_lines(content), ""]
    return "\n".join(lines)
