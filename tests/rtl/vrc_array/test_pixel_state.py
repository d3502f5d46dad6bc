"""The state of pixels between visits: a proof that no row is read before the last store of its tile has landed.

The proof holds for the array of 16 by 16 cores and for those of 8 by 8 of a machine with streams, any stream of visits and any
back-pressure. It is about any one row of any one tile, or of its region. The signals of `Harness.bad` that only help the
induction say which cycle of a store, or of a load, it is.
"""

from __future__ import annotations

import pytest
from amaranth.hdl import Elaboratable, Module, Mux, Signal

from rtl.vrc_array import expand
from rtl.vrc_array.batch_blocks import BatchSequencer
from rtl.vrc_array.batch_collect import BatchCollect
from rtl.vrc_array.collect import place_latency
from rtl.vrc_array.pixel_state import PixelState
from rtl.vrc_array.row import SUMS_LATER
from spec.config import V3, V3_STREAMS
from spec.supertiles import SUPER_PLACES
from tests.helpers.formal import Circuit


def depth(config):
    """Cycles of the induction: more than a store takes from its strobe to its last row."""
    return place_latency(config) + config.region + 7


PROPERTIES = ("load_early", "read_early", "store_twice", "overwritten")
"""What is to be proven; the other signals help."""


def row_bits(config):
    """Bits of a row's number in the region of an array, which is a whole tile with one stream."""
    return (config.region - 1).bit_length()


class _Watched(PixelState):
    """The unit, with the addresses that its memory of sums reads as `reads` and `read_at`."""

    def __init__(self, config):
        super().__init__(config)
        self.reads, self.read_at = Signal(), Signal(SUPER_PLACES + row_bits(config))

    def _part(self, m, name, *args):
        super()._part(m, name, *args)
        if name == "sums":
            memory = getattr(m.submodules, name)
            m.d.comb += [self.reads.eq(memory.read & ~memory.fresh), self.read_at.eq(memory.address)]


class Harness(Elaboratable):
    """Sequencer, collection and state as in BatchArray, with free visits: a load, then ops, then a store or a last background.

    The row `row` of the tile `tile` is watched. `store` and `load` count down the cycles of the tile's last store and load;
    they are 1 when the last row comes, or is read.
    """

    def __init__(self, config=V3):
        self.config = config
        self.sequencer, self.collect, self.state = BatchSequencer(config), BatchCollect(config), _Watched(config)
        bits = {"row": row_bits(config), "tile": SUPER_PLACES, "place": SUPER_PLACES, "quarter": 2}
        self.inputs = {
            name: Signal(bits.get(name, 1), name=f"free_{name}")
            for name in ("row", "tile", "valid", "place", "fresh", "ends", "final", "last", "ready",
                         *(("quarter",) if config.streams > 1 else ()))}
        names = (*PROPERTIES, "pending", "stored", "owed", "read", "unread", "open", "order")
        self.bad = {name: Signal(name=f"bad_{name}") for name in names}

    def elaborate(self, platform):
        m = Module()
        m.submodules.sequencer, m.submodules.collect, m.submodules.state = self.sequencer, self.collect, self.state
        chosen, row, tile = Signal(), Signal(row_bits(self.config)), Signal(SUPER_PLACES)
        m.d.sync += chosen.eq(1)
        if self.config.streams > 1:
            quarter = Signal(2)
            m.d.comb += self.collect.quarter.eq(quarter)
            with m.If(~chosen):
                m.d.sync += quarter.eq(self.inputs["quarter"])
        with m.If(~chosen):
            m.d.sync += [row.eq(self.inputs["row"]), tile.eq(self.inputs["tile"])]
        opened, place = self._visits(m, chosen)
        self._watch(m, chosen, row, tile, opened & (place == tile))
        return m

    def _visits(self, m, chosen):
        """Connects the units; returns whether a visit's load has been issued and not its last op, and its tile."""
        free, sequencer, collect, state = self.inputs, self.sequencer, self.collect, self.state
        op, opened, place = sequencer.ops.payload, Signal(), Signal(SUPER_PLACES)
        m.d.comb += [
            sequencer.ops.valid.eq(free["valid"] & chosen),
            op.load.eq(~opened), op.drain.eq(opened & free["ends"]), op.fresh.eq(free["fresh"]),
            op.last.eq(opened & Mux(free["ends"], free["final"], free["last"])),
            op.place.eq(Mux(opened, place, free["place"])),
            sequencer.may_drain.eq(collect.may_drain), sequencer.may_store.eq(collect.may_store),
            sequencer.may_load.eq(state.may_load),
            *(getattr(state, name).eq(getattr(sequencer, name)) for name in ("place", "fresh", "block", "loading", "storing")),
            *(getattr(collect, name).eq(getattr(sequencer, name)) for name in ("draining", "storing", "place")),
            state.stored.eq(collect.stored), collect.pixels.ready.eq(free["ready"]),
        ]
        with m.If(sequencer.ops.valid & sequencer.ops.ready):
            m.d.sync += opened.eq(~op.drain)
            with m.If(op.load):
                m.d.sync += place.eq(op.place)
        return opened, place

    def _watch(self, m, chosen, row, tile, opened):
        sequencer, state = self.sequencer, self.state
        ours = chosen & (sequencer.place == tile)
        storing, loading = sequencer.storing & ours, sequencer.loading & ~sequencer.fresh & ours
        comes = state.stored.valid & (state.stored.place == tile)
        bits, rows = row_bits(self.config), self.config.region
        reads, read_row = state.reads & (state.read_at[bits:] == tile), state.read_at[:bits]
        came = state.stored.row[:bits]
        lands = comes & (came == row)
        store, load = Signal(6), Signal(6)
        m.d.sync += [
            store.eq(Mux(storing, place_latency(self.config) + rows, store - store.any())),
            load.eq(Mux(loading, expand.latency(self.config) + SUMS_LATER + rows, load - load.any()))]
        owed, unread, early = Signal(), Signal(), Signal()
        m.d.sync += [
            owed.eq((owed | storing) & ~lands),
            unread.eq(loading | unread & ~(reads & (read_row == row) & (load <= rows))),
            early.eq(Mux(loading, owed, early) & ~lands)]  # the store before the last load is still under way
        stores, loads = store.any() & (store <= rows), load.any() & (load <= rows)
        bad = {
            "load_early": loading & owed,
            "read_early": reads & (read_row == row) & early,
            "store_twice": storing & owed,
            "overwritten": lands & unread,
            "pending": state.pending.bit_select(tile, 1) != store.any(),
            "stored": (comes != stores) | comes & (came + store != rows),
            "owed": owed != store.any() & (store + row >= rows),
            "read": loads & (~reads | (read_row + load != rows)) | reads & ~load.any(),
            "unread": unread != load.any() & (load + row >= rows),
            "open": opened & store.any(),
            "order": store.any() & load.any() & (load >= store),
        }
        m.d.comb += [self.bad[name].eq(chosen & value) for name, value in bad.items()]


def circuit(config, folder):
    harness = Harness(config)
    return Circuit(harness, [*harness.inputs.values()], harness.bad, folder)


@pytest.mark.parametrize("config", [pytest.param(V3, marks=pytest.mark.long), V3_STREAMS], ids=lambda config: config.name)
def test_no_row_is_read_before_its_store_has_landed(config, tmp_path):
    proof = circuit(config, tmp_path)
    assert proof.inductive(depth(config))
    assert not proof.fails(depth(config))


def _unheld(self, m, apart, last):
    """Loads are not held back."""
    PixelState._hold(self, m, apart, last)
    m.d.comb += self.may_load.eq(apart)


def _hasty(self, m, apart, last):
    """A store counts as landed a row too early."""
    PixelState._hold(self, m, apart, self._within(self.stored.row) == self.config.region - 2)


@pytest.mark.parametrize("config", [V3, V3_STREAMS], ids=lambda config: config.name)
@pytest.mark.parametrize(("fault", "found"), [(_unheld, "read_early"), (_hasty, "load_early")])
def test_faults_are_found(fault, found, config, tmp_path, monkeypatch):
    monkeypatch.setattr(_Watched, "_hold", fault, raising=False)
    assert circuit(config, tmp_path).fails(depth(config), found)
