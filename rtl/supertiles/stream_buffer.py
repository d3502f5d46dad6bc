"""The batch buffer of a machine with several streams: the same batches leave for every stream, each with its own visits.

                                       +-> BatchMasks 0 -> BatchVisits 0 -+-> visits 0
    supertiles, places -+--------------+        ...                       |
                        |              +-> BatchMasks 3 -> BatchVisits 3 -|-+-> visits 3
                        |                                                 v v
                        +-------------> banks of the memory of records -> entries 0, ..., 3

A place is filled for all streams at once. Each stream has masks of the places of its regions, and deals them at its own pace.
The memory of records is divided into banks by the lowest bits of a place's number in its batch. A bank is read at one address
in a cycle, for all streams that want it; streams whose banks are busy wait.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.select import select
from rtl.shapes import layout
from rtl.stream import Broadcast, Buffer
from rtl.supertiles.batch_buffer import BatchBuffer
from rtl.supertiles.batch_masks import BatchMasks, lowest
from rtl.supertiles.batch_visits import BatchVisits, batch_layout, item_layout
from rtl.supertiles.eyes import joint_settings
from spec.config import AcceleratorConfig
from spec.memory import splat_record
from spec.queues import COUNTER_BITS
from spec.supertiles import SEQUENCE_BITS, batch_place, batch_tiles, check_supertiles, supertile, tile_visit, visit_entry

_TAKEN = ("mean2d", "conic", "log2_opacity", "colour", "depth")
"""Fields of a splat record that an entry has unchanged."""


class StreamBuffer(BatchBuffer):
    """Takes the places of super-tiles, and delivers the visits of each stream with the entries of each visit.

    Parameters:
        config: the machine; it must have lists by super-tile and several streams.

    Ports: those of BatchBuffer, but `done`, `current`, `visits` and `entries` exist once for each stream. Visits are counted
    over all streams.

    Stop: as BatchBuffer for each stream, with one entry more that may leave.

    Storage: 2 x batch_places records in `config.batch_banks` banks; BatchMasks and BatchVisits for each stream; two entries and
    two visits for each stream. Throughput: one place a cycle, and one entry a cycle for each stream unless another stream reads
    another place of the same bank. Priority among streams changes in turn with every cycle. Latency: as BatchBuffer.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        if config.streams == 1:
            raise ValueError(f"streams must be more than 1 for this unit, not {config.streams!r}")
        self.config = config
        wiring.Component.__init__(self, {
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "places": In(stream.Signature(layout(batch_place(config)))),
            **joint_settings(config, "joint", "shift"),
            "done": In(batch_tiles(config)).array(config.streams), "current": In(SEQUENCE_BITS).array(config.streams),
            "visits": Out(stream.Signature(layout(tile_visit(config)))).array(config.streams),
            "entries": Out(stream.Signature(layout(visit_entry(config)))).array(config.streams),
            "clear": In(1),
            "batches": Out(COUNTER_BITS), "visits_count": Out(COUNTER_BITS),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        count = self.config.streams
        m.submodules.offers = every = Broadcast(batch_layout(self.config), count)
        m.d.comb += every.wanted.eq((1 << count) - 1)
        masks, sources, busy, released = [], [], [], []
        for q in range(count):
            m.submodules[f"masks_{q}"] = mask = BatchMasks(self.config)
            m.submodules[f"dealer_{q}"] = dealer = BatchVisits(self.config)
            m.submodules[f"items_{q}"] = items = Buffer(item_layout(self.config))
            wiring.connect(m, dealer.items, items.sink)
            wiring.connect(m, dealer.visits, wiring.flipped(self.visits[q]))
            batches = every.sources[q]
            m.d.comb += [
                dealer.done.eq(self.done[q]), dealer.current.eq(self.current[q]), *self._settings(dealer),
                dealer.batches.payload.eq(batches.payload), dealer.batches.payload.summary.eq(mask.summary),
                dealer.batches.valid.eq(batches.valid), batches.ready.eq(dealer.batches.ready),
                *(getattr(dealer, name).eq(getattr(mask, name)) for name in ("waiting", "waiting_half", "read_data")),
                *(getattr(mask, name).eq(getattr(dealer, name)) for name in ("read_en", "read_tile", "read_word", "read_half"))]
            masks.append(mask)
            sources.append(items.source)
            busy.append(dealer.busy | items.source.valid)
            released.append(Signal(2, name=f"released_{q}"))
        banks = []
        for b in range(self.config.batch_banks):
            m.submodules[f"records_{b}"] = bank = memory.Memory(
                shape=layout(splat_record(self.config)), depth=2 * self.config.batch_places // self.config.batch_banks, init=[])
            banks.append(bank)
        inside = self._fill(m, masks, [bank.write_port() for bank in banks], every.sink, self._released(m, released))
        passed = self._deliver_all(m, sources, [bank.read_port(transparent_for=()) for bank in banks], released)
        m.d.comb += self.busy.eq(inside | Cat(busy).any() | passed)
        self._count_all(m, every.sink)
        return m

    def _released(self, m: Module, released: list[Signal]) -> Value:
        """The halves that all streams have done with; a stream has done with a half once between two batches in it."""
        left = [Signal(self.config.streams, name=f"left_{half}") for half in range(2)]
        freed = []
        for half, streams in enumerate(left):
            now = streams | Cat(stream[half] for stream in released)
            m.d.sync += streams.eq(Mux(now.all(), 0, now))
            freed.append(now.all())
        return Cat(freed)

    def _deliver_all(
        self, m: Module, sources: list[stream.Interface], reads: list[memory.ReadPort], released: list[Signal],
    ) -> Value:
        """Reads records for all streams, and fills their `entries`; returns whether anything is on its way."""
        low, count = (len(reads) - 1).bit_length(), len(sources)
        turn, moving = Signal(range(count)), []
        m.d.sync += turn.eq(turn + 1)
        wants = Signal(count)
        grants = [Signal(count, name=f"grants_{b}") for b in range(len(reads))]
        places = [source.payload.address[low:] for source in sources]
        alike = [[Const(1) if p == q else Signal(name=f"alike_{q}_{p}") for p in range(count)] for q in range(count)]
        m.d.comb += [same.eq(places[q] == places[p]) for q, row in enumerate(alike) for p, same in enumerate(row) if p != q]
        for b, read in enumerate(reads):
            asks, turned, first, chosen = (Signal(count, name=f"{name}_{b}") for name in ("asks", "turned", "first", "chosen"))
            m.d.comb += [
                asks.eq(Cat(want & (source.payload.address[:low] == b) for want, source in zip(wants, sources, strict=True))),
                turned.eq(Cat(asks, asks) >> turn), first.eq(lowest(turned)), chosen.eq((Cat(first, first) << turn)[count:]),
                read.en.eq(asks.any()), read.addr.eq(select(chosen, places)),
                # a stream that wants the chosen one's place: the comparisons do not wait for the choice
                grants[b].eq(Cat(ask & (Cat(same) & chosen).any() for ask, same in zip(asks, alike, strict=True)))]
        for q, source in enumerate(sources):
            granted = Cat(grant[q] for grant in grants).any()
            moving.append(self._deliver_one(m, q, source, reads, wants[q], granted, released[q]))
        return Cat(moving).any()

    def _deliver_one(
        self, m: Module, q: int, source: stream.Interface, reads: list[memory.ReadPort], wants: Value, granted: Value,
        released: Signal,
    ) -> Value:
        """Takes the items of a stream, and makes its entries of what the banks answer a cycle later.

        At most two entries of a stream are in its buffer or on their way to it, so none has to wait at a bank, whose answer
        lasts for a cycle.
        """
        item, low = source.payload, (len(reads) - 1).bit_length()
        m.submodules[f"entries_{q}"] = entries = Buffer(self.entries[q].payload.shape())
        wiring.connect(m, entries.source, wiring.flipped(self.entries[q]))
        held = Signal(range(3), name=f"held_{q}")
        leaves, room, moves, plain = (Signal(name=f"{name}_{q}") for name in ("leaves", "room", "moves", "plain"))
        passed = Signal(name=f"passed_{q}")
        kept = Signal(data.StructLayout({"level": 2, "blend": 1, "end": 1, "bank": low}), name=f"kept_{q}", reset_less=True)
        half = item.address[-1]
        m.d.comb += [
            leaves.eq(self.entries[q].valid & self.entries[q].ready), room.eq((held != 2) | leaves),
            plain.eq(item.end | item.none), wants.eq(source.valid & room & ~plain),
            moves.eq(source.valid & room & (plain | granted)), source.ready.eq(moves),
            released.eq(Cat(moves & item.closes & ~half, moves & item.closes & half)),
        ]
        m.d.sync += [passed.eq(moves & ~item.none), held.eq(held + (moves & ~item.none) - leaves)]
        with m.If(moves):
            m.d.sync += [*(kept[name].eq(item[name]) for name in ("level", "blend", "end")), kept.bank.eq(item.address[:low])]
        record = Signal(layout(splat_record(self.config)), name=f"record_{q}")
        entry, bank = entries.sink.payload, Signal(len(reads), name=f"bank_{q}")
        m.d.comb += [
            bank.eq(Cat(kept.bank == b for b in range(len(reads)))),
            record.as_value().eq(select(bank, [read.data.as_value() for read in reads])),
            entries.sink.valid.eq(passed), entry.end.eq(kept.end),
            *(entry[name].eq(record[name]) for name in _TAKEN),
            entry.use.eq(Cat(1, kept.blend & (record.bound > kept.level)))]
        return passed | self.entries[q].valid

    def _count_all(self, m: Module, batches: stream.Interface) -> None:
        """Counts batches that all streams have, and visits that leave, each a cycle later."""
        if not self.config.counters:
            return
        passes = Signal(name="batch_moved")
        moved = Signal(self.config.streams, name="visit_moved")
        m.d.sync += [
            passes.eq(batches.valid & batches.ready & ~self.clear),
            moved.eq(Cat(visits.valid & visits.ready & ~self.clear for visits in self.visits)),
            self.batches.eq(Mux(self.clear, 0, self.batches + passes)),
            self.visits_count.eq(Mux(self.clear, 0, self.visits_count + sum(moved)))]
