"""A component as modules that are synthesised separately: its own module, and every shared module below it once."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from amaranth.back import rtlil
from amaranth.lib import wiring

from rtl.emit import Emission


@dataclass(frozen=True)
class Design:
    """The RTLIL of a component.

    Attributes:
        top: name of the component's own module.
        texts: RTLIL text of each module, lower modules first.
        below: for each module, how many instances of which shared modules it contains directly.
    """

    top: str
    texts: dict[str, str]
    below: dict[str, Counter[str]]

    def source(self, name: str) -> str:
        """RTLIL of a module, preceded by the ports of the modules that it instantiates."""
        return "\n".join([*(_ports(self.texts[box], box) for box in sorted(self.below[name])), self.texts[name]])

    def counts(self) -> Counter[str]:
        """How many instances of each module the whole component contains."""
        found = Counter({self.top: 1})
        for module in reversed(self.texts):
            for box, count in self.below[module].items():
                found[box] += found[module] * count
        return found


def _ports(text: str, name: str) -> str:
    """The ports of a module, without its contents; `text` may hold other modules below it, too."""
    start = text.index(f"module \\{name}\n")
    body = text[start:text.index("\nend\n", start)]
    return "\n".join([f"module \\{name}", *re.findall(r"(?m)^\s*wire .*(?:input|output|inout) \d+.*$", body), "end\n"])


def elaborate(component: wiring.Component, name: str) -> Design:
    """The modules of a component, whose own module is called `name`; the result is deterministic."""
    emission = Emission()
    top = rtlil.convert(component, name=name, platform=emission, emit_src=False)
    texts = {**emission.modules, name: top}
    below = {
        module: Counter(kind for kind in re.findall(r"(?m)^\s*cell \\(\S+) ", text) if kind in emission.modules)
        for module, text in texts.items()}
    return Design(name, texts, below)
