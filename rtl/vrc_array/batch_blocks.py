"""Issues the ops of visits to the array: as `rtl.vrc_array.blocks`, with loads and stores."""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.vrc_array.blocks import BlockSequencer
from rtl.vrc_array.pixel_core import index_shape
from spec.config import AcceleratorConfig
from spec.supertiles import batch_tile_bits, check_supertiles


class BatchSequencer(BlockSequencer):
    """Turns each op of a visit into one op per block.

    Parameters and ports: those of BlockSequencer, of which `may_drain` concerns backgrounds with `drain`, `draining` names
    stores too, and `waits` any op that is held back; and

        place, fresh, block: the tile of the op that waits or is issued, `fresh` of that op if it is a load, and its block.
        may_load, may_store: a load, or a store, of this tile may be issued now. They must not depend on `loading` and
            `storing`.
        loading, storing: strobes; a load, or a store, is issued, and `issue` shows it in the next cycle.

    Throughput, ordering and latency are those of BlockSequencer.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__(config)
        check_supertiles(config)

    def _ports(self) -> dict[str, wiring.Member]:
        return {
            **super()._ports(),
            "may_load": In(1), "may_store": In(1), "loading": Out(1), "storing": Out(1),
            "place": Out(batch_tile_bits(self.config)), "fresh": Out(1), "block": Out(index_shape(self.config.blocks)),
        }

    def _free(self, op: Any) -> Value:
        drain = Mux(op.last, self.may_drain, self.may_store)
        return (~op.drain | drain) & (~op.load | self.may_load)

    def _held(self, op: Any) -> Value:
        return self.ops.valid & ~self.ops.ready

    def _issue(self, m: Module, strobe: Value, op: Any, polynomial: dict[str, Value], block: Value | None) -> None:
        super()._issue(m, strobe, op, polynomial, block)
        m.d.comb += [
            self.place.eq(Cat(op.place, op.eye) if self.config.joint else op.place), self.fresh.eq(op.fresh),
            self.block.eq(Const(0) if block is None else block),
            self.loading.eq(strobe & op.load), self.storing.eq(strobe & op.drain & ~op.last)]
