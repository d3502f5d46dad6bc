"""The units whose mutants are judged: the suite of each, a machine, and the plans that the quick tests play."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

from spec.command_line import choice
from spec.config import AcceleratorConfig
from tb.common.exact import Planned

UNIT, RATE, QUICK = ("unit_plan",), ("unit_plan", "rate_plan"), ("quick_plan",)

FLOAT = "float"
"""Begins or ends the names of the instances of the float units, which have a target of their own."""


@dataclass(frozen=True)
class Target:
    """A unit with its suite.

    Attributes:
        name: the unit's name.
        module: the module of its suite.
        machine: the machine, of the suite's VARIANTS.
        plans: functions of the suite, each of which gives runs that a quick test plays.
        apart: parts of the names of instances inside whose mutants are not drawn, because they have a target of their own.
        seed: the seed of the plans.
        watchdog: a run is given up after so many cycles in which no item moves, or earlier where the suite says so. The sound
            circuit must pass with it.
    """

    name: str
    module: str
    machine: str = "tiny"
    plans: tuple[str, ...] = UNIT
    apart: tuple[str, ...] = ()
    seed: int = 0
    watchdog: int = 4000

    @property
    def suite(self) -> ModuleType:
        """The suite."""
        return importlib.import_module(self.module)

    @property
    def config(self) -> AcceleratorConfig:
        """The machine's configuration."""
        return self.suite.VARIANTS[self.machine]

    def plan(self) -> Sequence[Planned]:
        """All runs."""
        found: list[Planned] = []
        for name in self.plans:
            make = getattr(self.suite, name)
            found += make(self.config, self.seed) if make.__code__.co_argcount > 1 else make(self.config)
        return found


TARGETS: tuple[Target, ...] = (
    Target("chunk_sorter", "tb.sort_tmu.chunk_suite", plans=RATE),
    Target("tile_merge_unit", "tb.sort_tmu.tile_merge_suite"),
    Target("handover", "tb.sort_tmu.handover_suite"),
    Target("double_buffer", "tb.sort_tmu.handover_suite", "tiny-double"),
    Target("hierarchical_sorter", "tb.sort_tmu.hierarchical_suite", "small", ("directed_plan", "memory_plan", "rate_plan"),
           ("sorter.",), watchdog=20_000),
    Target("tile_test", "tb.culling.tile_test_suite", apart=(FLOAT,)),
    Target("tile_lists", "tb.tile_lists.suite", plans=RATE, apart=("merge_unit.",)),
    Target("splat_fetch", "tb.vrc_array.fetch_suite", plans=RATE),
    Target("pixel_writer", "tb.vrc_array.pixel_writer_suite", plans=RATE),
    Target("chunk_reader", "tb.chunks.reader_suite", "v3_records", RATE, ("decode.",)),
    Target("geometry_decode", "tb.chunks.decode_suite", "v3", RATE, (FLOAT,)),
    Target("supertile_clip", "tb.supertiles.clip_suite", "tiny_v3"),
    Target("supertile_test", "tb.supertiles.tile_test_suite", "tiny_v3", apart=(FLOAT,)),
    Target("depth_buckets", "tb.supertiles.buckets_suite", "tiny_v3"),
    Target("pair_writer", "tb.supertiles.lists_suite", "tiny_v3", RATE, ("merge.",)),
    Target("supertile_reader", "tb.supertiles.reader_suite", "tiny_v3"),
    Target("record_fetch", "tb.supertiles.record_fetch_suite", "tiny_v3", QUICK, ("decode.",)),
    Target("batch_buffer", "tb.supertiles.batch_suite", "tiny_v3"),
    Target("stream_buffer", "tb.supertiles.stream_suite", "tiny_streams"),
    Target("frame_packer", "tb.pixels.packer_suite", plans=RATE),
    Target("block_unpacker", "tb.pixels.unpacker_suite"),
    Target("float", "tb.float.suite", plans=QUICK),
    Target("projection_unit", "tb.culling.projection_suite", plans=RATE, apart=(FLOAT,)),
    Target("colour_unit", "tb.culling.colour_suite", plans=RATE, apart=(FLOAT,)),
    Target("vrc_array", "tb.vrc_array.array_suite", plans=("corner_plan", "random_plan", "stream_plan", "frame_plan")),
    Target("warp_unit", "tb.warp_unit.suite", plans=("directed_plan", "unit_plan", "rate_plan")),
    Target("chunk_test", "tb.chunks.chunk_test_suite", "v3_records", RATE, (FLOAT,)),
    Target("pair_colour", "tb.supertiles.colour_suite", "tiny_v3", RATE, (FLOAT,)),
    Target("batch_array", "tb.supertiles.array_suite", "tiny_v3", ("full_plan",)),
)
"""All of them, those of long arithmetic last. Bus, registers and the frame's controller have benches of their own kind, and
claims (docs/formal.md)."""


def named(name: str) -> Target:
    """The target of this name; InputError with what is accepted, and the nearest name."""
    names = {target.name: target for target in TARGETS}
    return names[choice("unit", name, sorted(names))]
