"""Projection, clip and tile test in machines whose phases overlap: a way through shared datapaths for each phase."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.near import near_shared
from rtl.culling.projection import projection_shared
from rtl.culling.projection_unit import COUNTS as PROJECTED
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.saturations import SaturationCounters
from rtl.shapes import layout
from rtl.supertiles.clip import SuperTileClip
from rtl.supertiles.level_table import SuperLevelTable
from rtl.supertiles.phase_test import PhaseTileTest, ellipse_shared
from rtl.top.splat_path import COUNTS, SATURATED, STAGES
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.queues import COUNTER_BITS
from spec.records import TILE_BITS, gaussian_point, surviving_splat, tile_level
from spec.supertiles import supertile, supertile_pair


class SplatPaths(wiring.Component):
    """What `SplatPath` does in turn, for both phases side by side::

        points ───► ProjectionUnit ─────────────────────► PhaseTileTest ─► binned        first phase
                      ┆                                      ┆    ▲ levels
        table ────────┆──────────────────────────────────────┆──► two SuperLevelTables
                      ┆ near test, projection                ┆    ▼ levels
        gathered ─► ProjectionUnit ─► SuperTileClip ────► PhaseTileTest ─► tested        second phase
                              supertiles ─▲                  ┆ ellipse test

    Of the datapaths there is one of each kind, which both phases use side by side (`SharedDatapath`): in every other round of
    its interval, a splat of the first phase goes first, and in the others one of the second. The table of a frame is filled in
    its first phase and read in both.

    Parameters:
        config: the machine, with overlapped phases.

    Ports:
        settings, second_settings: the settings of the frames in the first and in the second phase.
        clear: strobe before a frame's first phase, when nothing of that phase is inside.
        which: the level table that the first phase uses; the second one uses the other. It changes only while nothing is
            inside.
        table, points, gathered, supertiles, binned, tested: as in `SplatPath`.
        busy: a splat of the first phase is in the tile test.
        ready: with joint frames: what `clear` begins is done.
        stage_valid, stage_ready: handshakes of the input streams of STAGES, one bit each: whether either phase has an item, and
            whether one of either phase moves.
        culled_near, culled_faint, culled_outside, survivors, entries, filtered, saturated_means, saturated_depths,
        saturated_keys: counts of the first phase.

    Throughput: that of `SplatPath` for both phases together, and at least half of it for each. Latency and order: those of
    `SplatPath`.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not config.overlap:
            raise ValueError(f"overlap must be True, not {config.overlap!r}")
        self.config = config
        points, settings = In(stream.Signature(layout(gaussian_point(config)))), In(layout(frame_settings(config)))
        super().__init__({
            "settings": settings, "second_settings": settings, "clear": In(1), "which": In(1),
            "table": In(stream.Signature(layout(tile_level(config)))), "points": points, "gathered": points,
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "binned": Out(stream.Signature(layout(supertile_pair(config)))),
            "tested": Out(stream.Signature(layout(surviving_splat(config)))), "busy": Out(1),
            "stage_valid": Out(len(STAGES)), "stage_ready": Out(len(STAGES)), **{name: Out(COUNTER_BITS) for name in COUNTS},
            **({"ready": Out(1)} if config.joint else {})})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.near = near = near_shared(self.config)
        m.submodules.projection = projected = projection_shared(self.config)
        m.submodules.ellipse = ellipse = ellipse_shared(self.config)
        projections = [ProjectionUnit(self.config, sides) for sides in zip(near.sides, projected.sides, strict=True)]
        tests = [PhaseTileTest(self.config, second=bool(place), side=side) for place, side in enumerate(ellipse.sides)]
        for name, projection, test in zip(("first", "second"), projections, tests, strict=True):
            m.submodules[f"{name}_projection"], m.submodules[f"{name}_test"] = projection, test
        m.submodules.clip = clip = SuperTileClip(self.config)
        self._settings(m, (*projections, *tests))
        if self.config.joint:
            m.d.comb += [
                *(projection.rendering.eq(place) for place, projection in enumerate(projections)),
                clip.joint.eq(self.second_settings.joint), self.ready.eq(tests[0].ready)]
        wiring.connect(m, wiring.flipped(self.points), projections[0].sink)
        wiring.connect(m, projections[0].source, tests[0].splats)
        wiring.connect(m, tests[0].pairs, wiring.flipped(self.binned))
        wiring.connect(m, wiring.flipped(self.gathered), projections[1].sink)
        wiring.connect(m, projections[1].source, clip.splats)
        wiring.connect(m, wiring.flipped(self.supertiles), clip.supertiles)
        wiring.connect(m, clip.clipped, tests[1].splats)
        wiring.connect(m, tests[1].survivors, wiring.flipped(self.tested))
        m.d.comb += [clip.rendering.eq(1), tests[0].clear.eq(self.clear), self.busy.eq(tests[0].busy)]
        self._levels(m, tests)
        for place, inputs in enumerate(([p.sink for p in projections], [t.splats for t in tests])):
            m.d.comb += [
                self.stage_valid[place].eq(inputs[0].valid | inputs[1].valid),
                self.stage_ready[place].eq((inputs[0].valid & inputs[0].ready) | (inputs[1].valid & inputs[1].ready))]
        if self.config.counters:
            self._count(m, projections[0], tests[0])
        return m

    def _settings(self, m: Module, units: tuple[wiring.Component, ...]) -> None:
        """Gives the units of the two phases, which alternate, the settings of their frames."""
        for number, unit in enumerate(units):
            settings = self.second_settings if number % 2 else self.settings
            for name in settings.shape().members:
                if name in unit.signature.members:
                    m.d.comb += getattr(unit, name).eq(settings[name])

    def _levels(self, m: Module, tests: list[PhaseTileTest]) -> None:
        """Adds the tables: the first phase's is filled, and both are read."""
        size = {name: Signal(TILE_BITS + 1, name=name) for name in ("tiles_x", "tiles_y")}
        for name, setting in zip(size, ("width", "height"), strict=True):
            m.d.sync += size[name].eq((self.settings[setting] + (TILE - 1)) >> (TILE.bit_length() - 1))
        tables = [SuperLevelTable(self.config) for _ in range(2)]
        for number, table in enumerate(tables):
            m.submodules[f"levels_{number}"] = table
            first = self.which == number
            m.d.comb += [
                table.table.valid.eq(self.table.valid & first), table.table.payload.eq(self.table.payload),
                table.clear.eq(self.clear & first), table.tiles_x.eq(size["tiles_x"]), table.tiles_y.eq(size["tiles_y"]),
                *(getattr(table, name).eq(Mux(first, getattr(tests[0], name), getattr(tests[1], name)))
                  for name in ("enable", "row", "group", *(("eye",) if self.config.joint else ()))),
                *(getattr(table, name).eq(self.settings[name]) for name in ("joint", "shift") if self.config.joint)]
        m.d.comb += self.table.ready.eq(Mux(self.which, tables[1].table.ready, tables[0].table.ready))
        for number, test in enumerate(tests):
            own = self.which ^ number
            m.d.comb += [
                test.levels.eq(Mux(own, tables[1].levels, tables[0].levels)),
                test.filled.eq(Mux(own, tables[1].filled, tables[0].filled))]

    def _count(self, m: Module, projection: ProjectionUnit, test: PhaseTileTest) -> None:
        m.submodules.saturations = counts = SaturationCounters(self.config)
        splats = projection.source
        m.d.comb += [
            counts.clear.eq(self.clear), counts.splats.eq(splats.payload),
            counts.splats_move.eq(splats.valid & splats.ready & ~splats.payload.end),
            *(getattr(self, name).eq(getattr(projection, name)) for name in PROJECTED),
            *(getattr(self, name).eq(getattr(counts, name)) for name in SATURATED),
            self.survivors.eq(test.survivors_count), self.entries.eq(test.entries), self.filtered.eq(test.filtered)]
