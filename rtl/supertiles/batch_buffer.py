"""The batch buffer: places of a super-tile come in rendering order, and leave tile by tile as entries of visits.

    supertiles, places -+-> BatchMasks -> BatchVisits -+-> visits
                        |                              |
                        +---> memory of records -------+-> entries

The memory of records has two halves. One is filled with a batch, a place a cycle, while the batch in the other is dealt to its
tiles, an entry a cycle. `spec.supertiles` says what a batch is and which tiles are visited.
"""

from __future__ import annotations

from functools import reduce
from operator import and_
from typing import Any, NamedTuple

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.batch_masks import BatchMasks
from rtl.supertiles.batch_visits import BatchVisits, both_eyes, item_layout
from rtl.supertiles.eyes import joint_settings
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES
from spec.joint import EYES
from spec.memory import splat_record
from spec.queues import COUNTER_BITS
from spec.supertiles import (
    SEQUENCE_BITS,
    batch_place,
    batch_tiles,
    check_supertiles,
    supertile,
    tile_visit,
    visit_entry,
)

LATENCY = 9
"""Cycles from the transfer of a batch's last place to that of its first entry if nothing waits and no batch is being dealt."""


class _Eyes(NamedTuple):
    """What depends on whether a frame is a joint one.

        whole: a SuperTile is offered that is its super-tile's last.
        taken: what is done when it is taken.
        waits: a super-tile's first item has come, and not its last; None where they are the same.
        target: the item of the target; None in machines without joint frames.
        limit: number in the batch of the first place that can be the last one of a batch.
    """

    whole: Value
    taken: list[Any]
    waits: Value | None
    target: data.View | None
    limit: Value | int


class BatchBuffer(wiring.Component):
    """Takes the places of super-tiles, and delivers the visits of their tiles with the entries of each.

    Parameters:
        config: the machine; it must have lists by super-tile.

    Ports:
        supertiles: SuperTile items, empty super-tiles too, in order; in joint frames that of the target behind that of the
            source.
        places: BatchPlace items of these super-tiles, in order; each super-tile gets as many with `last` as it has pairs. A
            place is an entry of those tiles of its mask, in its eye, that have its level. In machines with a warp unit an item
            with `none` ends a pair and is no place.
        done, current: from the array: tiles of super-tile number `current`, as `batch_tiles` counts them, of which all pixels
            have stopped. A bit that is set stays so until `current` changes. Bits count while `current` is the sequence number
            of the visit's super-tile.
        visits: TileVisit items. Super-tiles are numbered from the last reset on, not by frame, so that the first one of a frame
            has another number than the last one of the frame before, whose `done` may still stand.
        entries: VisitEntry items; an item with `end` closes each visit. A visit may be taken before the last entry of the one
            before it.
        joint, shift: settings of the frame, in machines with joint frames.
        clear: strobe between frames: the counts restart from 0.
        batches, visits_count: batches dealt and visits since `clear`; always 0 without `config.counters`.
        busy: a super-tile is inside.

    Stop: a tile that has stopped is not visited in a batch that is not its super-tile's last. A visit of a tile that stops
    meanwhile ends early; at most four of its entries leave from the cycle on in which its bit of `done` is set.

    Storage: 2 x batch_places records, for PAPER's formats of 222 bits, in one memory that is read and written in the same cycle
    in different halves; that of BatchMasks; two super-tiles of about 1,000 bits for each eye, and two visits. Throughput: one
    place and one entry a cycle, together; between two batches no place is taken for 2 cycles; a visit takes one cycle more than
    it has entries. Latency: LATENCY cycles from a batch's last place to its first entry.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config = config
        super().__init__({
            **joint_settings(config, "joint", "shift"),
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "places": In(stream.Signature(layout(batch_place(config)))),
            "done": In(batch_tiles(config)), "current": In(SEQUENCE_BITS),
            "visits": Out(stream.Signature(layout(tile_visit(config)))),
            "entries": Out(stream.Signature(layout(visit_entry(config)))),
            "clear": In(1),
            "batches": Out(COUNTER_BITS), "visits_count": Out(COUNTER_BITS),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.masks = masks = BatchMasks(self.config)
        m.submodules.dealer = dealer = BatchVisits(self.config)
        m.submodules.items = items = Buffer(item_layout(self.config))
        m.submodules.records = records = memory.Memory(
            shape=layout(splat_record(self.config)), depth=2 * self.config.batch_places, init=[])
        wiring.connect(m, dealer.items, items.sink)
        wiring.connect(m, dealer.visits, wiring.flipped(self.visits))
        m.d.comb += [
            dealer.done.eq(self.done), dealer.current.eq(self.current), *self._settings(dealer),
            *(getattr(dealer, name).eq(getattr(masks, name)) for name in ("waiting", "waiting_half", "read_data")),
            *(getattr(masks, name).eq(getattr(dealer, name)) for name in ("read_en", "read_tile", "read_word", "read_half")),
        ]
        released = Signal(2)  # the half whose last place has been read
        inside = self._fill(m, [masks], [records.write_port()], dealer.batches, released)
        passed = self._deliver(m, items.source, records.read_port(transparent_for=()), released)
        m.d.comb += self.busy.eq(inside | dealer.busy | items.source.valid | passed)
        self._count(m, dealer.batches)
        return m

    def _settings(self, dealer: BatchVisits) -> list[Any]:
        """Passes on the settings of joint frames."""
        return [getattr(dealer, name).eq(getattr(self, name)) for name in ("joint", "shift") if self.config.joint]

    def _fill(
        self, m: Module, masks: list[BatchMasks], banks: list[memory.WritePort], batches: stream.Interface, released: Value,
    ) -> Value:
        """Takes super-tiles and their places, and passes on complete batches; returns whether there is a super-tile. Each
        stream has masks of its own; the lowest bits of a place's number in its batch choose the bank.

        A super-tile is `held`; one of its batches is being filled while it is `open`, and waits to be dealt while `closed`.
        """
        most = self.config.batch_places
        tile, place, batch = Signal(self.supertiles.payload.shape(), reset_less=True), self.places.payload, batches.payload
        held, open_, closed, final, half = Signal(), Signal(), Signal(), Signal(), Signal()
        full = Signal(2)  # halves with a batch that is being dealt
        count, left = Signal(range(most), reset_less=True), Signal.like(self.supertiles.payload.pairs, name="left")
        sequence = Signal(SEQUENCE_BITS)
        taken, passes, last_pair, ends = Signal(), Signal(), Signal(), Signal()
        ready, settled = (reduce(and_, (getattr(unit, name) for unit in masks)) for name in ("ready", "settled"))
        low = len(banks).bit_length() - 1
        eyes = self._eyes(m, tile)
        # an item without a place counts as a pair alone; the masks need to know if it closes a batch
        filled, whole, marked = (taken & ~place.none, place.last & ~place.none, taken & (~place.none | ends)) if (
            self.config.warps_joint) else (taken, place.last, taken)
        m.d.comb += [
            self.places.ready.eq(open_ & ready & ~full.bit_select(half, 1)),
            taken.eq(self.places.valid & self.places.ready),
            last_pair.eq(place.last & (left == 1)),
            ends.eq(last_pair | whole & (count >= eyes.limit)),
            *(port.eq(value) for number, write in enumerate(banks) for port, value in (
                (write.en, filled & (count[:low] == number) if low else filled),
                (write.addr, Cat(count[low:] if low else count, half)),
                *((write.data[name], place[name]) for name in write.data.shape().members))),
            *(port.eq(value) for number, unit in enumerate(masks) for port, value in (
                (unit.take, marked), (unit.closes, ends), (unit.half, half), (unit.begin, passes),
                (unit.tiles, self._own_tiles(place, place.mask[number] if len(masks) > 1 else place.mask, tile, eyes.target)))),
            batches.valid.eq(closed & settled & ~full.bit_select(half, 1)),
            *(batch[name].eq(self._of_eyes(name, tile, eyes.target))
              for name in batch.shape().members if name in tile.shape().members),
            batch.sequence.eq(sequence), batch.half.eq(half), batch.final.eq(final), batch.summary.eq(masks[0].summary),
            passes.eq(batches.valid & batches.ready),
            self.supertiles.ready.eq(~held | passes & final),
        ]
        m.d.sync += full.eq(full & ~released | Cat(passes & ~half, passes & half))
        with m.If(taken):
            m.d.sync += count.eq(count + (~place.none if self.config.warps_joint else 1))
            with m.If(place.last):  # which comes late, so that it may not be a term of the sum
                m.d.sync += left.eq(left - 1)
            with m.If(ends):
                m.d.sync += [open_.eq(0), closed.eq(1), final.eq(last_pair)]
        with m.If(passes):
            m.d.sync += [closed.eq(0), open_.eq(~final), half.eq(~half), count.eq(0), sequence.eq(sequence + final)]
        with m.If(self.supertiles.ready):
            m.d.sync += held.eq(eyes.whole)
            with m.If(eyes.whole):
                none = self.supertiles.payload.pairs == 0
                m.d.sync += [*eyes.taken, left.eq(self.supertiles.payload.pairs), open_.eq(~none),
                             closed.eq(none), final.eq(none)]
            m.d.sync += count.eq(0)
        return held if eyes.waits is None else held | eyes.waits

    def _eyes(self, m: Module, tile: data.View) -> _Eyes:
        """What depends on whether a frame is a joint one; `tile` is the source's item."""
        most, valid, item = self.config.batch_places, self.supertiles.valid, self.supertiles.payload
        if not self.config.joint:
            return _Eyes(valid, [tile.eq(item)], None, None, most - MAX_LEVELS)
        target = Signal(item.shape(), name="target", reset_less=True)
        limit, waits = Signal(range(most), reset_less=True), Signal()
        m.d.sync += limit.eq(Mux(self.joint, most - EYES * MAX_LEVELS, most - MAX_LEVELS))
        with m.If(self.supertiles.ready & valid):
            m.d.sync += waits.eq(self.joint & ~item.eye)
            with m.If(item.eye):
                m.d.sync += target.eq(item)
            with m.Else():
                m.d.sync += tile.eq(item)
        return _Eyes(valid & (~self.joint | item.eye), [], waits, target, limit)

    def _own_tiles(self, place: data.View, mask: Value, tile: data.View, target: data.View | None) -> Value:
        """The tiles that a place is an entry of."""
        mine = mask & Cat(tile.level[n] == place.level for n in range(SUPER_TILES))
        if target is None:
            return mine
        other = mask & Cat(target.level[n] == place.level for n in range(SUPER_TILES))
        return Cat(mine & ~place.eye.replicate(SUPER_TILES), other & place.eye.replicate(SUPER_TILES))

    def _of_eyes(self, name: str, tile: data.View, target: data.View | None) -> Value:
        """A field of a batch that is one of its super-tile."""
        if target is None or name not in both_eyes(self.config):
            return Value.cast(tile[name])
        other = Value.cast(target[name])
        return Cat(Value.cast(tile[name]), other & self.joint.replicate(len(other)) if name == "inside" else other)

    def _deliver(self, m: Module, items: stream.Interface, read: memory.ReadPort, released: Signal) -> Value:
        """Reads records and registers `entries`; returns whether anything is on its way."""
        item, entry = items.payload, Signal(self.entries.payload.shape(), reset_less=True)
        passed, leaves, room, moves = Signal(), Signal(), Signal(), Signal()
        kept = Signal(data.StructLayout({"level": 2, "blend": 1, "end": 1}), reset_less=True)
        half = item.address[-1]
        m.d.comb += [
            leaves.eq(~self.entries.valid | self.entries.ready), room.eq(~passed | leaves),
            items.ready.eq(room), moves.eq(items.valid & room),
            read.en.eq(moves & ~item.end & ~item.none), read.addr.eq(item.address),
            released.eq(Cat(moves & item.closes & ~half, moves & item.closes & half)),
            self.entries.payload.eq(entry),
        ]
        with m.If(room):
            m.d.sync += passed.eq(moves & ~item.none)
        with m.If(moves):
            m.d.sync += [kept[name].eq(item[name]) for name in ("level", "blend", "end")]
        with m.If(leaves):
            m.d.sync += self.entries.valid.eq(passed)
        with m.If(leaves & passed):
            m.d.sync += entry.end.eq(kept.end)
        with m.If(leaves & passed & ~kept.end):
            m.d.sync += [entry[name].eq(read.data[name]) for name in ("mean2d", "conic", "log2_opacity", "colour", "depth")]
            m.d.sync += entry.use.eq(Cat(1, kept.blend & (read.data.bound > kept.level)))
        return passed | self.entries.valid

    def _count(self, m: Module, batches: stream.Interface) -> None:
        """Counts batches that begin to be dealt and visits that leave, each a cycle later."""
        if not self.config.counters:
            return
        for name, counter, counted in (("batch", self.batches, batches), ("visit", self.visits_count, self.visits)):
            moved = Signal(name=f"{name}_moved")
            m.d.sync += [moved.eq(counted.valid & counted.ready & ~self.clear),
                         counter.eq(Mux(self.clear, 0, counter + moved))]
