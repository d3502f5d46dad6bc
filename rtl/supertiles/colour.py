"""The colour unit of machines with super-tiles: splat records of pairs for the batch buffer."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.colour import splat_interval
from rtl.culling.compact_sum import CompactColourSum
from rtl.culling.datapath import Datapath
from rtl.culling.harmonics import OFFSETS, harmonics_graph
from rtl.shapes import layout
from rtl.supertiles.pair_places import PairPlaces
from spec.config import AcceleratorConfig
from spec.harmonics import terms
from spec.memory import read_data
from spec.records import surviving_splat
from spec.supertiles import batch_place, check_supertiles

_LEFT_OUT = ("index", "offset", "log2_opacity", "end")


def carried_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The fields that pass the unit unchanged. Opacities come from the compact records."""
    return data.StructLayout({name: field.shape for name, field in layout(surviving_splat(config)) if name not in _LEFT_OUT})


class PairColour(wiring.Component):
    """Evaluates the harmonics of pairs, and makes a splat record for each of their levels. Frames of degree 0 need none, and
    pass at their own rate.

        survivors -+-> Datapath(harmonics) --> CompactColourSum -+-> PairPlaces --> places
                   |                                  ^          |
                   +------------> CompactColourSum of degree 0 --+
                                                      ^
        data -----------------------------------------+

    Parameters:
        config: the machine, with super-tiles.
        sh_degree: degree of the largest records, 0..3; hardware that only higher degrees need is left out.

    Ports:
        survivors: SurvivingSplat items, one per pair, with a level each; `end` is not looked at.
        data: the pairs' beats, in order: CompactColour, and CompactHarmonics where `sh_degree` is not 0. They may come before
            or after their survivors. `error` is not looked at: who reads memory reports errors.
        places: BatchPlace items, pair by pair, for each pair the lowest level first.
        sh_degree: setting of the frame, at most the parameter; changes only while the unit is empty, and a cycle before the
            first pair or beat of the frame is offered.

    Throughput: one pair every `splat_interval` cycles, with degree 0 every cycle, or a cycle for each of its levels where those
    are more. Latency from the transfer of a pair to its first place: that of the datapath, plus the degree's steps and 7
    cycles; with degree 0, 3 cycles.
    """

    def __init__(self, config: AcceleratorConfig, *, sh_degree: int = 3) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(sh_degree, int) or isinstance(sh_degree, bool):
            raise TypeError(f"sh_degree must be an integer, not {sh_degree!r}")
        if not 0 <= sh_degree <= 3:
            raise ValueError(f"sh_degree must be in 0..3, not {sh_degree!r}")
        check_supertiles(config)
        self._degree, interval, carried = sh_degree, splat_interval(config), carried_layout(config)
        if sh_degree:
            self._path = Datapath(harmonics_graph(config, sh_degree), interval=interval, carried=carried)
            self._sum = CompactColourSum(
                config, sh_degree=sh_degree, lanes=-(-terms(sh_degree) // interval), carried=carried)
        self._plain = CompactColourSum(config, sh_degree=0, lanes=0, carried=carried)
        self._places = PairPlaces(config, carried=carried)
        super().__init__({
            "survivors": In(stream.Signature(layout(surviving_splat(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "places": Out(stream.Signature(layout(batch_place(config)))),
            "sh_degree": In(2),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.plain, m.submodules.places = plain, places = self._plain, self._places
        wiring.connect(m, places.places, wiring.flipped(self.places))
        basis, item = plain.basis, self.survivors.payload
        carried = Cat(Value.cast(item[name]) for name in basis.payload.carried.shape().members)
        m.d.comb += [Value.cast(basis.payload.carried).eq(carried), plain.data.payload.eq(self.data.payload)]
        if not self._degree:
            m.d.comb += [
                basis.valid.eq(self.survivors.valid), self.survivors.ready.eq(basis.ready),
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
                (self.survivors, path.sink, basis), (self.data, total.data, plain.data)):
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
