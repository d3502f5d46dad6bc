"""Writes the results as JSON, as CSV for every picture, as Markdown and as one HTML page."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from golden.scenes.files import atomic_output
from msv2.studies.area.estimate import BUILDS
from msv2.studies.page import fill, write_page
from msv2.studies.record import write_report
from msv2.studies.tradeoff import pages
from msv2.studies.tradeoff.crops import Crop, sheet
from msv2.studies.tradeoff.frontiers import frontiers
from msv2.studies.tradeoff.knobs import BASE
from msv2.studies.tradeoff.tables import Content, trainingtable
from msv2.studies.web.maker import write_html
from spec.config import AcceleratorConfig
from spec.constants import REGION_START_DEG
from spec.paths import DOCS

DOCUMENT = DOCS / "tradeoff.md"
"""The page that explains the study, and that begins with the answer on the embedded scene."""

DETAILS = {"settings": "machine", "runs": "training"}
"""Pictures of all measured points, by the frontier that they belong to."""


def known_areas(path: Path) -> dict[AcceleratorConfig, float]:
    """Area in mm^2 at 16 nm of the machines of `msv2.studies.area.estimate.BUILDS` in reports/area.json, all named as BASE is.
    Empty if the report is missing."""
    builds = json.loads(path.read_text())["builds"] if path.is_file() else {}
    return {config.with_(name=BASE.name): builds[name]["mm2_16nm"] for name, config in BUILDS.items() if name in builds}


def write(content: Content, out: Path, name: str, configuration: object = None, inputs: Sequence[Path | str] = ()) -> None:
    """Writes NAME.json, and for machine, simulation and training a CSV file.

    Args:
        content: the content of the report.
        out: an existing folder.
        name: the name of the files.
        configuration, inputs: the configuration and the inputs for the provenance.
    """
    write_report(out / f"{name}.json", content, ["msv2.studies.tradeoff.study"], configuration, inputs)
    tables = {"machine": machinetable(content["machine"]), "simulation": [dict(r) for r in content["simulation"]["rows"]],
              "training": trainingtable(content["training"])}
    for picture, rows in tables.items():
        write_page(out / f"{name}_{picture}.csv", as_csv(rows))


def write_pages(content: Content, out: Path, name: str, crops: Sequence[Crop] = ()) -> None:
    """Writes NAME.md and NAME.html, NAME_crops.png if there are crops, and with matplotlib a PNG of each frontier and of
    DETAILS. The HTML page contains its pictures."""
    found, drawn = frontiers(content), {}
    if find_spec("matplotlib") is not None:
        from msv2.studies.tradeoff import plot

        for frontier in found:
            drawn[frontier.name] = out / f"{name}_{frontier.name}.png"
            plot.save(frontier, drawn[frontier.name])
        for picture, part in DETAILS.items():
            if content[part]:
                drawn[picture] = out / f"{name}_{picture}.png"
                plot.save_details(picture, content, drawn[picture])
    if crops:
        with atomic_output(out / f"{name}_crops.png") as file:
            sheet(crops).save(file, format="PNG", optimize=True)
        drawn["crops"] = out / f"{name}_crops.png"
    pictures = {picture: path.name for picture, path in drawn.items()}
    given = content, found, pictures, crops, Path(os.path.relpath(DOCUMENT, out)).as_posix()
    write_page(out / f"{name}.md", pages.as_markdown(*given))
    write_html(out / f"{name}.html", pages.as_html(*given), drawn.values())


def fill_document(content: Content, check: bool = False) -> int:
    """Writes the answer of reports/tradeoff.json into docs/tradeoff.md; with `check`, only finds out whether it would change.
    Returns 1 if it would, else 0."""
    found = frontiers(content)
    pictures = {frontier.name: f"../reports/tradeoff_{frontier.name}.png" for frontier in found}
    return fill(DOCUMENT, {"answer": lambda: pages.answer(found, pictures)}, check=check, complete=True)


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


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as CSV, with columns in the order in which they first appear."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
