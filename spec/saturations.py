"""Which values count as saturated, among those that the hardware clamps to their formats before the array.

A value counts as saturated where it equals a limit of its format: the largest value, and for signed numbers the least, too. The
0 of unsigned numbers is no limit, because colours below 0 are black by definition, and nothing before the near plane has a
depth. A value that was rounded to a limit counts like one that was clamped to it. So every count follows from the records that
pass one place of the machine. Each record is counted once, when it is transferred:

    splats    ProjectedSplat records, from projection to the tile test: one for each Gaussian that is not culled
    views     splat records (SplatRecord), from the colour unit to memory: one for each level of the tiles that a
              splat intersects; with super-tiles BatchPlace records, from the colour unit to the batch buffer: one for each
              level of the tiles of a super-tile that a splat intersects, so a splat counts once for each of its pairs

With super-tiles, splats are counted in the first phase only.

Keys and depths of intersections are those of their splats, and are not counted again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from spec.config import AcceleratorConfig
from spec.formats import Fixed
from spec.memory import splat_record
from spec.records import Field, Record, projected_splat


@dataclass(frozen=True)
class Saturation:
    """A kind of saturation.

    Attributes:
        name: name of its counter.
        doc: what is counted: records in which a number of `field` is at a limit.
        stream: the place where the records pass, one of STREAMS.
        field: name of the record's field.
    """

    name: str
    doc: str
    stream: str
    field: str

    def field_of(self, config: AcceleratorConfig) -> Field:
        """The record's field, with its format."""
        return next(f for f in STREAMS[self.stream](config).fields if f.name == self.field)


STREAMS: dict[str, Callable[[AcceleratorConfig], Record]] = {"splats": projected_splat, "views": splat_record}
"""The records that are watched, by the name of the place where they pass."""

SATURATIONS = (
    Saturation("saturated_means", "splats whose projected mean has a coordinate at its least or largest value", "splats",
               "mean2d"),
    Saturation("saturated_depths", "splats with the largest depth", "splats", "depth"),
    Saturation("saturated_keys", "splats with the largest depth key", "splats", "depth_key"),
    Saturation("saturated_colours", "splat records with a channel of either level at its largest value", "views", "colour"),
)
"""All kinds of saturation that are counted, in the order of the counters."""


def limits(number: Fixed) -> tuple[int, ...]:
    """Raw values of a format that count as saturated."""
    return (number.raw_min, number.raw_max) if number.signed else (number.raw_max,)
