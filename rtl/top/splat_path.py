"""The units of machines with super-tiles that serve both phases of a frame in turn: projection, clip and tile test."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.projection_unit import COUNTS as PROJECTED
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.saturations import SaturationCounters
from rtl.shapes import layout
from rtl.supertiles.clip import SuperTileClip
from rtl.supertiles.sweep_turns import SweepTurns
from rtl.supertiles.tile_test import SuperTileTest
from rtl.top.ports import connect_settings, watch
from spec.config import AcceleratorConfig
from spec.memory import frame_settings
from spec.queues import COUNTER_BITS
from spec.records import gaussian_point, surviving_splat, tile_level
from spec.saturations import WATCHED
from spec.supertiles import check_supertiles, supertile, supertile_pair

STAGES = ("projection", "tile_test")
"""Stages whose input streams are watched by the performance counters, in both phases."""

SATURATED = tuple(s.name for s in WATCHED if s.stream == "splats")
"""Those of COUNTS that `SaturationCounters` counts."""

COUNTS = (*PROJECTED, "survivors", "entries", "filtered", *SATURATED)
"""What is counted, in the first phase alone."""


class SplatPath(wiring.Component):
    """Projects Gaussians and finds their tiles: in the first phase all Gaussians that are read, and in the second those of the
    sorted pairs::

        points    ─┐
                   ├► ProjectionUnit ─► SuperTileClip ─► SuperTileTest ─┬─► binned        first phase
        gathered  ─┘             supertiles ─▲       table ─▲           └─► tested        second phase

    In a joint frame (`spec.joint`) the projection unit makes two splats of every Gaussian, the source's and the target's. In
    machines with a warp unit SweepTurns stands where `supertiles` come in, and a pair of the second phase may have one splat.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        settings: the frame's settings.
        clear: strobe between frames, when nothing is inside.
        rendering: level: the second phase. It changes only while nothing is inside.
        table: TileLevel items, before a frame's Gaussians; in joint frames those of the source and then those of the target.
        points: GaussianPoint items of the first phase; the last one is `end`. gathered: those of the second, one for each pair.
        supertiles: SuperTile items of the second phase (`SuperTileClip`), in joint frames two for each super-tile.
        binned: SuperTilePair items of the first phase, then `end`.
        tested: SurvivingSplat items of the second phase, one for each pair; in joint frames two, that of the source first, each
            with the tiles of its eye, of which there may be none.
        busy: a splat is in the clip or in the tile test.
        ready: with joint frames: what `clear` begins is done.
        second: with a warp unit: `supertiles` are those of the second sweep.
        stage_valid, stage_ready: handshakes of the input streams of STAGES, one bit each.
        culled_near, culled_faint, culled_outside, survivors, entries, filtered, saturated_means, saturated_depths,
        saturated_keys: counts of the first phase; they keep their values in the second.

    Throughput, latency and order: those of the three units, one after the other.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config = config
        points = In(stream.Signature(layout(gaussian_point(config))))
        super().__init__({
            "settings": In(layout(frame_settings(config))), "clear": In(1), "rendering": In(1),
            "table": In(stream.Signature(layout(tile_level(config)))), "points": points, "gathered": points,
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "binned": Out(stream.Signature(layout(supertile_pair(config)))),
            "tested": Out(stream.Signature(layout(surviving_splat(config)))), "busy": Out(1),
            "stage_valid": Out(len(STAGES)), "stage_ready": Out(len(STAGES)), **{name: Out(COUNTER_BITS) for name in COUNTS},
            **({"ready": Out(1)} if config.joint else {}), **({"second": In(1)} if config.warps_joint else {})})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.projection = projection = ProjectionUnit(self.config)
        m.submodules.clip = clip = SuperTileClip(self.config)
        m.submodules.tile_test = test = SuperTileTest(self.config)
        for unit in (projection, test):
            connect_settings(m, self, unit)
        m.d.comb += [
            projection.sink.valid.eq(Mux(self.rendering, self.gathered.valid, self.points.valid)),
            projection.sink.payload.eq(Mux(self.rendering, self.gathered.payload, self.points.payload)),
            self.points.ready.eq(projection.sink.ready & ~self.rendering),
            self.gathered.ready.eq(projection.sink.ready & self.rendering),
            clip.rendering.eq(self.rendering), test.rendering.eq(self.rendering), test.clear.eq(self.clear),
            self.busy.eq(clip.busy | test.busy)]
        if self.config.joint:
            connect_settings(m, self, clip)
            m.d.comb += [projection.rendering.eq(self.rendering), self.ready.eq(test.ready)]
        wiring.connect(m, projection.source, clip.splats)
        if self.config.warps_joint:
            self._turn(m, projection, clip)
        else:
            wiring.connect(m, wiring.flipped(self.supertiles), clip.supertiles)
        wiring.connect(m, clip.clipped, test.splats)
        wiring.connect(m, wiring.flipped(self.table), test.table)
        wiring.connect(m, test.pairs, wiring.flipped(self.binned))
        wiring.connect(m, test.survivors, wiring.flipped(self.tested))
        watch(m, self, (projection.sink, test.splats))
        if self.config.counters:
            self._count(m, projection, test)
        return m

    def _turn(self, m: Module, projection: ProjectionUnit, clip: SuperTileClip) -> None:
        """Tells projection and clip for which eyes the pairs of each super-tile are projected."""
        m.submodules.turns = turns = SweepTurns(self.config)
        wiring.connect(m, wiring.flipped(self.supertiles), turns.supertiles)
        wiring.connect(m, turns.turns, projection.turns)
        wiring.connect(m, turns.clipped, clip.supertiles)
        shared = Signal(reset_less=True)
        m.d.sync += shared.eq(self.settings.shared_colour & self.settings.sh_degree.any())
        m.d.comb += [turns.joint.eq(self.settings.joint), turns.stereo.eq(self.settings.stereo), turns.shared.eq(shared),
                     turns.second.eq(self.second)]

    def _count(self, m: Module, projection: ProjectionUnit, test: SuperTileTest) -> None:
        """The projection unit begins its counts anew with the second phase's first splat, so those of the first are kept."""
        m.submodules.saturations = counts = SaturationCounters(self.config)
        splats = projection.source
        with m.If(~self.rendering):
            m.d.sync += [getattr(self, name).eq(getattr(projection, name)) for name in PROJECTED]
        m.d.comb += [
            counts.clear.eq(self.clear), counts.splats.eq(splats.payload),
            counts.splats_move.eq(splats.valid & splats.ready & ~splats.payload.end & ~self.rendering),
            *(getattr(self, name).eq(getattr(counts, name)) for name in SATURATED),
            self.survivors.eq(test.survivors_count), self.entries.eq(test.entries), self.filtered.eq(test.filtered)]
