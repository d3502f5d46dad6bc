"""What can be synthesised: units by name, with the hints their carry chains need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from amaranth.lib import wiring

from rtl.vrc_array.pixel_core import PixelCore
from rtl.vrc_array.row import VrcRow
from spec.config import DEFAULT, AcceleratorConfig


@dataclass(frozen=True)
class Unit:
    """A unit of the machine.

    Attributes:
        make: the component of a configuration.
        config: the configuration it is reported for.
        variants: further configurations reported beside it, by name.
        blocks: incremented blocks at the top of a sum's carry chain, lowest first, by the name of the sum (`synth.heap`).
            Found by lengthening the chain of the worst path until 1,000 ps were met; a name that no sum bears is ignored.
        boxes: how many of which other units it instantiates; they are synthesised apart.
    """

    make: Callable[[AcceleratorConfig], wiring.Component]
    config: AcceleratorConfig = DEFAULT
    variants: Mapping[str, AcceleratorConfig] = field(default_factory=dict)
    blocks: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    boxes: Mapping[str, int] = field(default_factory=dict)


UNITS: dict[str, Unit] = {
    "pixel_core": Unit(
        make=PixelCore,
        variants={
            "levels=1": DEFAULT.with_(levels=1),
            "depth=False": DEFAULT.with_(depth=False),
            "levels=1, depth=False": DEFAULT.with_(levels=1, depth=False),
        },
        blocks={"after": (4, 4, 5), "less": (4,), "total0": (5,), "total1": (5,), "total2": (5,), "total3": (6, 5),
                "exponent_below": (6,)},
    ),
    "vrc_row": Unit(make=VrcRow, boxes={"pixel_core": DEFAULT.cores_x}),
}
