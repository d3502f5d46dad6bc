"""docs/effects.md: the effects of `spec.effects`, and what becomes of those that a frame does not call for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from spec import effects
from spec.effects import EFFECTS, GIVEN
from spec.paths import DOCS

_COMMANDS = """
`python golden/render.py` and `make frame` find out what the model and the request call for, print a line for each effect
with the reason, and keep that in their JSON. `--effects` (`EFFECTS=`) is `auto`, `all`, `none`, or names with commas between
them. The golden renderer has kernels without depth sums, tile tests without levels, and colours of any degree. `make frame`
builds the machine without the units of absent effects and keeps its simulator; `--machine full` (`MACHINE=full`) builds all
of the configuration, where they idle. A forced second eye is rendered and dropped: through the RTL in frames for displays,
as no other frames have two eyes. `make table-effects` measures what each effect costs, with `AREA=1` in area, too.
"""


def page() -> str:
    """The page."""
    rows = ["| effect | what it is | needs | without it a frame saves | can be forced |", "|---|---|---|---|---|"]
    rows += [f"| `{e.name}` | {e.doc} | {', '.join(f'`{need}`' for need in e.needs) or '-'} | {e.without} | "
             f"{'no' if e.name in GIVEN else 'yes'} |" for e in EFFECTS.values()]
    text = (effects.__doc__ or "").partition("\n\n")[2].strip()
    head = ["# Effects", "", "Written by `python -m msv2.document` from `spec/effects.py`.", ""]
    return "\n".join([*head, text, _COMMANDS, *rows, ""])


PAGES: dict[Path, Callable[[], str]] = {DOCS / "effects.md": page}
