"""The colour unit of machines with super-tiles: splat records of pairs for the batch buffer."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.colour import splat_interval
from rtl.culling.compact_sum import CompactColourSum
from rtl.culling.datapath import Datapath
from rtl.culling.harmonics import OFFSETS, harmonics_graph
from rtl.shapes import layout
from rtl.stream import Buffer, Skid
from rtl.supertiles.eyes import joint_settings
from rtl.supertiles.pair_places import CARRIED, PairPlaces
from spec.config import AcceleratorConfig
from spec.harmonics import terms
from spec.joint import EYES
from spec.memory import read_data
from spec.queues import COLOURS_BESIDE
from spec.records import surviving_splat
from spec.supertiles import batch_place, check_supertiles

_LEFT_OUT = ("index", "offset", "log2_opacity", "alone", "end")


def carried_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The fields that pass the unit unchanged. Opacities come from the compact records. In machines with joint frames, `last`
    says that nothing of the pair follows."""
    fields = {name: field.shape for name, field in layout(surviving_splat(config)) if name not in _LEFT_OUT}
    return data.StructLayout(fields | {"last": 1} if config.joint else fields)


class PairColour(wiring.Component):
    """Evaluates the harmonics of pairs, and makes a splat record for each of their levels. Frames of degree 0 need none, and
    pass at their own rate.

        survivors -+-> Datapath(harmonics) --> CompactColourSum -+-> PairPlaces --> places
                   |                                  ^          |
                   +------------> CompactColourSum of degree 0 --+
                                                      ^
        data -----------------------------------------+

    In machines with joint frames, what a place takes unchanged waits in a queue beside this path. So a pair whose colours are
    those of both eyes passes the path once, and a splat without a level not at all. A splat of the source waits for that of
    the target, which says whether the pair ends with it:

        survivors --> held -+-> path: directions --> sums -+-> PairPlaces --> places
                            +-> queue: splats -------------+

    Parameters:
        config: the machine, with super-tiles.
        sh_degree: degree of the largest records, 0..3; hardware that only higher degrees need is left out.

    Ports:
        survivors: SurvivingSplat items, one per pair, with a level each; `end` is not looked at. In joint frames two per pair,
            of the source and of the target, of which one may have no level. In machines with a warp unit a pair may have one,
            `alone`, and no level at all (`spec.joint_warp`); it then has a place with `none`.
        data: the pairs' beats, in order: CompactColour, and CompactHarmonics where `sh_degree` is not 0. They may come before
            or after their survivors. `error` is not looked at: who reads memory reports errors.
        places: BatchPlace items, pair by pair, for each pair the lowest level first; in joint frames those of the source before
            those of the target.
        sh_degree: setting of the frame, at most the parameter; changes only while the unit is empty, and a cycle before the
            first pair or beat of the frame is offered.
        joint, shared_colour: settings of the frame, in machines with joint frames; they change as `sh_degree` does.

    Throughput: one pair every `splat_interval` cycles, with degree 0 every cycle, or a cycle for each of its levels where those
    are more. In joint frames a pair with levels in both eyes takes two intervals, unless both have the same colours; one with
    levels in a single eye may take a cycle more than an interval; and no pair less than two cycles. Latency from the transfer
    of a pair to its first place: that of the datapath, plus the degree's steps and 7 cycles; with degree 0, 3 cycles. Machines
    with joint frames take a cycle more, with degree 0 two, and in joint frames another one. A place may wait in a register at
    the end, so that `ready` of `places` reaches nothing else in the same cycle.
    """

    def __init__(self, config: AcceleratorConfig, *, sh_degree: int = 3) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(sh_degree, int) or isinstance(sh_degree, bool):
            raise TypeError(f"sh_degree must be an integer, not {sh_degree!r}")
        if not 0 <= sh_degree <= 3:
            raise ValueError(f"sh_degree must be in 0..3, not {sh_degree!r}")
        check_supertiles(config)
        self.config, self._degree, interval = config, sh_degree, splat_interval(config)
        self._splat = carried_layout(config)
        carried = CARRIED if config.joint else self._splat
        if sh_degree:
            self._path = Datapath(harmonics_graph(config, sh_degree), interval=interval, carried=carried)
            self._sum = CompactColourSum(
                config, sh_degree=sh_degree, lanes=-(-terms(sh_degree) // interval), carried=carried)
        self._plain = CompactColourSum(config, sh_degree=0, lanes=0, carried=carried)
        self._places = PairPlaces(config, carried=self._splat)
        super().__init__({
            **joint_settings(config, "joint", "shared_colour"),
            "survivors": In(stream.Signature(layout(surviving_splat(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "places": Out(stream.Signature(layout(batch_place(config)))),
            "sh_degree": In(2),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.plain, m.submodules.places = plain, places = self._plain, self._places
        m.submodules.leaving = leaving = Skid(self.places.payload.shape())  # the batch buffer's `ready` comes late
        wiring.connect(m, places.places, leaving.sink)
        wiring.connect(m, leaving.source, wiring.flipped(self.places))
        survivors, basis = self._survivors(m), self._plain_basis(m)
        item = survivors.payload
        carried = Cat(Value.cast(item[name]) for name in basis.payload.carried.shape().members)
        m.d.comb += [Value.cast(basis.payload.carried).eq(carried), plain.data.payload.eq(self.data.payload)]
        if not self._degree:
            m.d.comb += [
                basis.valid.eq(survivors.valid), survivors.ready.eq(basis.ready),
                plain.data.valid.eq(self.data.valid), self.data.ready.eq(plain.data.ready)]
            wiring.connect(m, plain.sums, places.sums)
            return m
        m.submodules.path, m.submodules.sum = path, total = self._path, self._sum
        wiring.connect(m, path.source, total.basis)
        shaded = Signal(reset_less=True)  # from a register, because it selects hundreds of bits before the sums of PairPlaces
        m.d.sync += shaded.eq(self.sh_degree.any())
        m.d.comb += [
            total.sh_degree.eq(self.sh_degree),
            Value.cast(path.sink.payload.carried).eq(carried),
            *(path.sink.payload[name].eq(item.offset[i]) for i, name in enumerate(OFFSETS)),
            total.data.payload.eq(self.data.payload),
        ]
        for source, with_, without in (
                (survivors, path.sink, basis), (self.data, total.data, plain.data)):
            m.d.comb += [
                with_.valid.eq(source.valid & shaded), without.valid.eq(source.valid & ~shaded),
                source.ready.eq(Mux(shaded, with_.ready, without.ready))]
        m.d.comb += [
            places.sums.valid.eq(Mux(shaded, total.sums.valid, plain.sums.valid)),
            Value.cast(places.sums.payload).eq(
                Mux(shaded, Value.cast(total.sums.payload), Value.cast(plain.sums.payload))),
            total.sums.ready.eq(places.sums.ready & shaded), plain.sums.ready.eq(places.sums.ready & ~shaded),
        ]
        return m

    def _plain_basis(self, m: Module) -> stream.Interface:
        """Where items enter the path of degree 0. In machines with joint frames they are as long on their way as splats are in
        the queue, so that neither waits for the other."""
        if not self.config.joint:
            return self._plain.basis
        m.submodules.delay = delay = Buffer(self._plain.basis.payload.shape())
        wiring.connect(m, delay.source, self._plain.basis)
        return delay.sink

    def _survivors(self, m: Module) -> stream.Interface:
        """The items for which colours are evaluated: those of `survivors`, or in machines with joint frames fewer, with `keep`.
        There the queue gets every splat with a level."""
        if not self.config.joint:
            return self.survivors
        depth = self._path.schedule.depth if self._degree else 0
        m.submodules.splats = queue = SyncFIFOBuffered(width=self._splat.size, depth=EYES * (depth + COLOURS_BESIDE))
        taken, item = self.survivors.payload.shape().members, self.survivors.payload
        shaped = data.StructLayout({**taken, "keep": 1})
        wanted = stream.Signature(shaped).create(path=("wanted",))
        held, there, once = Signal(item.shape(), name="held", reset_less=True), Signal(), Signal(reset_less=True)
        splat, known, has, more, shades, moves = (
            Signal(self._splat, name="splat"), *(Signal(name=name) for name in ("known", "has", "more", "shades", "moves")))
        m.d.sync += once.eq(self.joint & (self.shared_colour | ~self.sh_degree.any()))
        last, follows, first, empty = ~self.joint | held.eye, self.joint & ~held.eye, ~held.eye, None
        if self.config.stereo:
            seen = Signal()  # the pair's item before this one has a level
            last, follows, first = last | held.alone, follows & ~held.alone, first | held.alone
            empty = last & ~held.levels.any() & ~seen
            with m.If(moves):
                m.d.sync += seen.eq(follows & has)
        m.d.comb += [
            known.eq(there & (last | self.survivors.valid)),
            has.eq(held.levels.any() if empty is None else held.levels.any() | empty),
            more.eq(follows & item.levels.any()), shades.eq(Mux(once, first, has)),
            wanted.valid.eq(known & shades & (queue.w_rdy | ~has)), wanted.payload.keep.eq(has & more & ~once),
            moves.eq(known & (wanted.ready | ~shades) & (queue.w_rdy | ~has)),
            queue.w_en.eq(moves & has), queue.w_data.eq(splat), splat.last.eq(~more),
            *(wanted.payload[name].eq(held[name]) for name in taken),
            *(splat[name].eq(held[name]) for name in self._splat.members if name != "last"),
            self.survivors.ready.eq(~there | moves),
            self._places.once.eq(once), self._places.splats.valid.eq(queue.r_rdy),
            self._places.splats.payload.eq(queue.r_data), queue.r_en.eq(self._places.splats.ready)]
        with m.If(self.survivors.ready):
            m.d.sync += there.eq(self.survivors.valid)
            with m.If(self.survivors.valid):
                m.d.sync += held.eq(item)
        return wanted
