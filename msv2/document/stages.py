"""docs/stages.md: the machine's stages, and where each lives in the golden renderer, the RTL and the test bench."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from msv2.document.text import table
from spec import stages
from spec.paths import DOCS


def _code(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "-"


def page() -> str:
    """The page."""
    text = (stages.__doc__ or "").partition("\n\n")[2].strip()
    what = table(("stage", "phase", "what it does"), (
        (f"`{stage.name}`", stage.phase.value, stage.does) for stage in stages.EVERY_STAGE))
    where = table(("stage", "golden modules", "RTL modules", "units", "test suites", "`TEST=`", "counters"), (
        (f"`{stage.name}`", _code(stage.golden), _code(stage.rtl), _code(stage.units), _code(stage.suites), f"`{stage.test}`",
         _code(stage.counters)) for stage in stages.EVERY_STAGE))
    head = ["# Stages", "", "Written by `python -m msv2.document` from `spec/stages.py`.", ""]
    return "\n".join([*head, text, "", *what, "## Where each stage lives", "", *where]).rstrip() + "\n"


PAGES: dict[Path, Callable[[], str]] = {DOCS / "stages.md": page}
