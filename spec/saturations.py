"""What counts as saturated, of the values that hardware clamps to their formats on the way to the array.

A value counts where it equals its format's limit: the largest, and of signed numbers the least, too. The 0 of unsigned numbers
is no limit: colours below it are black by definition, and nothing in front of the near plane has a depth. What rounds to a
limit counts like what was clamped to it. So every count can be read off the records that pass one place of the machine, each
counted once, when it is transferred:

    splats    ProjectedSplat records, from projection to the tile test: one for each point that is not culled
    views     SplatView records, from the colour unit to memory: one for each level of the tiles that a splat has entries in

Keys and depths of entries are those of their splats, and are not counted again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from spec.config import AcceleratorConfig
from spec.formats import Fixed
from spec.memory import splat_view
from spec.records import Field, Record, projected_splat


@dataclass(frozen=True)
class Saturation:
    """A kind of saturation.

    Attributes:
        name: of its counter.
        doc: what is counted: records that have a number of `field` at a limit.
        stream: where the records pass, one of STREAMS.
        field: of the record.
    """

    name: str
    doc: str
    stream: str
    field: str

    def field_of(self, config: AcceleratorConfig) -> Field:
        """The field, with its format."""
        return next(f for f in STREAMS[self.stream](config).fields if f.name == self.field)


STREAMS: dict[str, Callable[[AcceleratorConfig], Record]] = {"splats": projected_splat, "views": splat_view}
"""Records by the place where they pass."""

SATURATIONS = (
    Saturation("saturated_means", "splats with a coordinate of the projected mean at its least or largest", "splats", "mean2d"),
    Saturation("saturated_depths", "splats with the largest depth", "splats", "depth"),
    Saturation("saturated_keys", "splats with the largest depth key", "splats", "depth_key"),
    Saturation("saturated_colours", "views with a channel of either level at its largest", "views", "colour"),
)
"""All that is counted, in the order of the counters."""


def limits(number: Fixed) -> tuple[int, ...]:
    """Raw values of a format that count as saturated."""
    return (number.raw_min, number.raw_max) if number.signed else (number.raw_max,)
