"""Which values count as saturated, among those that the hardware clamps to their formats before the array.

A value counts as saturated where it equals a limit of its format: the largest value, and for signed numbers the least, too. The
0 of unsigned numbers is no limit, because colours below 0 are black by definition, and nothing before the near plane has a
depth. A value that was rounded to a limit counts like one that was clamped to it. So every count follows from the records that
pass one place of the machine. Each record is counted once, when it is transferred:

    points    Gaussians in projection: those that are culled as outside although their box meets the frame, because a
              coordinate of their mean is at a limit (`spec.guard_band`); the projection unit counts them itself
    splats    ProjectedSplat records, from projection to the tile test: one for each Gaussian that is not culled
    views     splat records (SplatRecord), from the colour unit to memory: one for each level of the tiles that a
              splat intersects; with super-tiles BatchPlace records, from the colour unit to the batch buffer: one for each
              level of the tiles of a super-tile that a splat intersects, so a splat counts once for each of its pairs

With super-tiles, points and splats are counted in the first phase only.

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
        stream: the place where they pass: POINTS, or one of STREAMS, whose records are watched.
        field: name of the record's field.
    """

    name: str
    doc: str
    stream: str
    field: str

    def field_of(self, config: AcceleratorConfig) -> Field:
        """The record's field, with its format."""
        record = projected_splat if self.stream == POINTS else STREAMS[self.stream]
        return next(f for f in record(config).fields if f.name == self.field)


POINTS = "points"
"""The place where means are counted."""

STREAMS: dict[str, Callable[[AcceleratorConfig], Record]] = {"splats": projected_splat, "views": splat_record}
"""The records that are watched, by the name of the place where they pass."""

SATURATIONS = (
    Saturation("saturated_means", "Gaussians culled as outside only because their projected mean has a coordinate at its least "
               "or largest value", POINTS, "mean2d"),
    Saturation("saturated_depths", "splats with the largest depth", "splats", "depth"),
    Saturation("saturated_keys", "splats with the largest depth key", "splats", "depth_key"),
    Saturation("saturated_colours", "splat records with a channel of either level at its largest value", "views", "colour"),
)
"""All kinds of saturation that are counted, in the order of the counters."""

WATCHED = tuple(saturation for saturation in SATURATIONS if saturation.stream in STREAMS)
"""Those that are counted in the records of STREAMS."""


def limits(number: Fixed) -> tuple[int, ...]:
    """Raw values of a format that count as saturated."""
    return (number.raw_min, number.raw_max) if number.signed else (number.raw_max,)
