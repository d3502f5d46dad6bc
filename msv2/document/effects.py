"""Makes docs/effects.md: the effects of `spec.effects`, and what happens to those that a frame does not call for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from spec import effects
from spec.effects import EFFECTS, GIVEN
from spec.paths import DOCS

_COMMANDS = """
`python golden/render.py` and `make frame` find out what the model and the request call for, print one line per effect
with the reason, and write the same into their JSON. `--effects` (`EFFECTS=`) is `auto`, `all`, `none`, or names separated by
commas. The golden renderer has kernels without depth sums, tile tests without levels, and colours of every degree. `make frame`
builds the machine without the units of absent effects and caches its simulator; `--machine full` (`MACHINE=full`) builds the
whole configuration, in which those units idle. A forced second eye is rendered and dropped; the RTL does this in frames for
displays only, as no other frames have two eyes. `make table-effects` measures what each effect costs in cycles, and with
`AREA=1` in area, too.
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
