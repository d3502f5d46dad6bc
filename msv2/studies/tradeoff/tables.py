"""The tables of the tradeoff study in Markdown. Every number in them comes from the study's content."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.memory import cycles_cells, cycles_heads
from msv2.studies.page import table
from msv2.studies.tradeoff.choose import BUDGETS
from msv2.studies.tradeoff.knobs import DEFAULT, PRESET
from spec.constants import REGION_START_DEG

Content = Mapping[str, Any]

COSTS = ("times the default's speed", "frames/s at 1 GHz", "chip, mJ", "DRAM, mJ", "area, mm²", "bits of all formats",
         "loss, dB", "HVSQ")


def trainingtable(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A table with one row for each stage of the training."""
    return [{"scene": run["scene"], "variant": run["variant"], "size": "x".join(map(str, run["size"])), **stage}
            for run in runs for stage in run["stages"]]


def _cell(value: object, form: str, scale: float = 1.0) -> str:
    return "-" if value is None else format(value * scale if scale != 1.0 else value, form)


def _area(row: Mapping[str, Any]) -> str:
    return "unknown" if row["area_mm2"] is None else f"{row['area_mm2']:.2f}"


def what(row: Mapping[str, Any]) -> str:
    """The name of a setting."""
    if row["knob"] == DEFAULT:
        return "the default"
    return ", ".join(" ".join(part) for part in row["parts"]) or f"{row['knob']} {row['value']}"


def recommendation(content: Content) -> str:
    """A table of the fastest setting for each budget."""
    rows, head = [], [*cycles_heads(content["machine"]), *COSTS]
    for budget in BUDGETS:
        row = content["recommended"][budget.name]
        if row is None:
            rows.append([budget.name, "none", *["-"] * len(head)])
            continue
        rows.append([budget.name, what(row), *_costs(row)])
    return table(["loss accepted", "fastest setting", *head], rows)


def presets(content: Content) -> str:
    """A table of the default machine and the presets."""
    rows = []
    for row in content["machine"]:
        if row["knob"] in (DEFAULT, PRESET) and not row.get("error"):
            worst = f"{row['worst_error_255']:.2f}" + (f" **breaks {len(row['broken'])}**" if row["broken"] else "")
            rows.append(["the default" if row["knob"] == DEFAULT else f"`{row['value']}`", *_costs(row),
                         f"{row['psnr_oracle_db']:.2f}", worst])
    return table(["machine", *cycles_heads(content["machine"]), *COSTS, "PSNR oracle, dB", "worst hard case, /255"], rows)


def _costs(row: Mapping[str, Any]) -> list[str]:
    """The cells of the cycles and for the columns COSTS."""
    return [*cycles_cells(row), f"{row['speedup']:.2f}", f"{row['fps']:,.0f}", f"{row['chip_mj']:.4f}",
            f"{row['dram_mj']:.4f}", _area(row), str(row["word_bits"]), _cell(row["loss_db"], "+.4f"),
            _cell(row["hvsq_change"], "+.2%")]


def machine_lines(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table of all settings; those on the frontier are bold."""
    cells, cycles = [], cycles_heads(rows)
    for row in rows:
        name = (("**" if row["pareto"] else "") + what(row) + ("**" if row["pareto"] else ""))
        stable = f"{row['worst_error_255']:.2f}" + (f" **breaks {len(row['broken'])}**" if row["broken"] else "")
        if row.get("error"):
            cells.append([name, *["-"] * (10 + len(cycles)), stable + f"; cannot be: {row['error']}"])
            continue
        cells.append([
            name, *cycles_cells(row), f"{row['fps']:,.0f}", f"{row['chip_mj']:.4f}", f"{row['dram_mj']:.4f}", _area(row),
            _cell(row["psnr_photo_db"], ".3f"), _cell(row["ssim_photo"], ".4f"), _cell(row["loss_db"], "+.4f"),
            f"{row['psnr_oracle_db']:.2f}", _cell(row["hvsq"], ".3f", 1e5), _cell(row["hvsq_change"], "+.2%"), stable])
    return table(["setting", *cycles, "frames/s", "chip, mJ", "DRAM, mJ", "area, mm²", "PSNR photo, dB", "SSIM", "loss, dB",
                   "PSNR oracle, dB", "HVSQ, 1e-5", "HVSQ change", "worst hard case, /255"], cells)


def ring_lines(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table of the quality of all settings by eccentricity."""
    names = [f"from {start:g}°" for start in REGION_START_DEG]
    cells = [[what(row), *(_cell(v, ".2f") for v in row["ring_psnr_db"]), *(_cell(v, ".3f", 1e5) for v in row["hvsq_regions"])]
             for row in rows if not row.get("error")]
    return table(["setting", *(f"PSNR oracle {n}" for n in names), *(f"HVSQ {n}" for n in names)], cells)


def broken_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A list of the hard cases that settings break, at most three of each."""
    return [f"- {what(row)}: {name}: {why}" for row in rows for name, why in list(row["broken"].items())[:3]]


def simulation_lines(content: Content) -> str:
    """A table of the renderers."""
    cells = []
    for row in content["simulation"]["rows"]:
        error = _cell(row["cycle_error"], "+.2%") + (f" ({row['cycle_error_of']})" if row.get("cycle_error_of") else "")
        cells.append([row["name"], row["what"], f"{1e3 * row['wall_s']:,.1f}", f"{row['psnr_oracle_db']:.2f}",
                      f"{255 * row['max_abs_error']:.2f}", _cell(row["cycles"], ",.0f"), error])
    return table(["renderer", "what it is", "wall time, ms", "PSNR oracle, dB", "worst error, /255", "cycles", "cycle error"],
                  cells)


def training_lines(content: Content) -> str:
    """A table of the stages of the finished training runs."""
    cells = [[f"{row['scene']}-{row['variant']}, {row['size']}", row["stage"], f"{row['iterations']:,}",
              f"{row['seconds']:,.0f}", f"{row['points']:,}", f"{row['entries']:,.0f}", f"{row['psnr']:.2f}",
              f"{row['ssim']:.4f}", _cell(row["hvsq"], ".3f", 1e5)] for row in trainingtable(content["training"])]
    if not cells:
        return "No finished run was found."
    return table(["run", "stage", "iterations so far", "seconds so far", "points", "entries", "PSNR, dB", "SSIM",
                   "HVSQ, 1e-5"], cells)
