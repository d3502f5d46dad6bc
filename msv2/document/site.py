"""The documentation as a site: the pages of docs/, and a page of docstrings for every package.

The site is static, uses no font and no script of another host, and is built without the network.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from spec.command_line import command_parser
from spec.errors import InputError
from spec.extras import how_to_get
from spec.paths import DOCS, REPORTS, ROOT
from spec.private import locked
from spec.progress import phase
from spec.sources import ROOMS

SECTIONS: dict[str, tuple[str, ...]] = {
    "Start": ("gallery", "results", "architecture"),
    "The machine": ("machine", "stages", "array", "colour", "stereo", "effects", "formats", "registers", "units",
                    "streams"),
    "In your own design": ("take_one_unit", "verilog", "driver", "fpga"),
    "Models and pictures": ("viewer", "video", "levels", "training", "oracle", "cuda", "threshold", "stability"),
    "Numbers": ("synthesis", "area", "energy", "performance_model", "sweep", "tile_size", "tradeoff", "reports"),
}
"""Pages by section, in reading order; a page that is not named here comes last, under "More"."""

PLUGIN = "mkdocstrings"
"""Of the extra `docs`, with mkdocs-material: it reads docstrings without importing a module."""


def api_pages() -> dict[str, str]:
    """Markdown of the API pages by name: one for each package of each room, its modules in alphabetical order."""
    pages: dict[str, str] = {}
    for room in ROOMS:
        for package in sorted({path.parent for path in (ROOT / room).rglob("*.py")}):
            name = ".".join(package.relative_to(ROOT).parts)
            modules = sorted(path.stem for path in package.glob("*.py") if path.stem not in ("__init__", "__main__"))
            own = [f"::: {name}\n"] if (package / "__init__.py").stat().st_size else []
            if own or modules:
                pages[name] = "\n".join([f"# {name}\n", *own, *(f"::: {name}.{module}\n" for module in modules)])
    return pages


def page_title(path: Path) -> str:
    """The first heading of a page; its file's name where it has none."""
    found = re.search(r"(?m)^# (.+)$", path.read_text(encoding="utf-8"))
    return re.sub(r"[`*]", "", found[1]) if found else path.stem


def navigation(folder: Path) -> list[dict[str, object]]:
    """The site's menu: the sections' pages that are in `folder`, what no section names, and the API."""
    named = [name for names in SECTIONS.values() for name in names]
    rest = tuple(sorted(path.stem for path in folder.glob("*.md") if path.stem not in (*named, "index")))
    menu: list[dict[str, object]] = [{"Overview": "index.md"}]
    for section, names in {**SECTIONS, "More": rest}.items():
        pages = [{page_title(folder / f"{name}.md"): f"{name}.md"} for name in names if (folder / f"{name}.md").exists()]
        if pages:
            menu.append({section: pages})
    return [*menu, {"API": [{path.stem: f"api/{path.name}"} for path in sorted((folder / "api").glob("*.md"))]}]


def settings(source: Path, site: Path) -> dict[str, object]:
    """What mkdocs is asked for; JSON, which is YAML, too."""
    python = {"paths": [str(ROOT)], "options": {"show_root_heading": True, "show_source": False, "members_order": "source",
                                                "heading_level": 2, "docstring_style": "google"}}
    return {
        "site_name": "MSV2", "site_description": "An open accelerator for foveated Gaussian splatting",
        "docs_dir": str(source), "site_dir": str(site), "use_directory_urls": False,
        "theme": {"name": "material", "font": False, "features": ["navigation.sections", "toc.follow"]},
        "plugins": ["search", {PLUGIN: {"handlers": {"python": python}}}],
        "markdown_extensions": ["tables", "toc", "md_in_html", "pymdownx.superfences"], "nav": navigation(source),
        "validation": {"links": {"not_found": "warn", "unrecognized_links": "ignore"}},
    }


def gather(source: Path) -> None:
    """Copies pages, pictures and the kept reports that pages show or link to `source`, with the README as its index, and
    writes the API pages beside them."""
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(DOCS, source)
    shutil.copytree(REPORTS, source / REPORTS.name, ignore=shutil.ignore_patterns("*.json"))
    for page in source.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace("](../reports/", "](reports/"), encoding="utf-8")
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    (source / "index.md").write_text(front.replace("](docs/", "]("), encoding="utf-8")
    (source / "api").mkdir()
    for name, text in api_pages().items():
        (source / "api" / f"{name}.md").write_text(text, encoding="utf-8")


def build(out: Path) -> Path:
    """Builds the site into `out/site` and returns its first page.

    Raises:
        InputError: mkdocs-material or mkdocstrings is not installed, or mkdocs fails.
    """
    if any(importlib.util.find_spec(name) is None for name in ("mkdocs", "material", PLUGIN)):
        raise InputError(f"the site needs mkdocs-material and mkdocstrings; {how_to_get('mkdocs')}")
    source, site = out / "source", out / "site"
    out.mkdir(parents=True, exist_ok=True)
    with locked(out / "lock", f"waiting for another run that builds the site in {out}"), phase("building the site"):
        gather(source)
        config = out / "mkdocs.yml"
        config.write_text(json.dumps(settings(source, site), indent=1), encoding="utf-8")
        command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--clean", "-f", str(config)]
        if subprocess.run(command, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}).returncode:
            raise InputError("mkdocs could not build the site (its own message is above)")
    return site / "index.html"


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = command_parser("python -m msv2.document.site", __doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "docs", metavar="DIR", help="default: build/docs")
    print(build(parser.parse_args(argv).out))
    return 0
