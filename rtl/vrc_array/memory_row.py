"""A row of the array of a machine whose banks are in memories: what a small array on an FPGA needs.

A core of such an array computes many pixels in turn, whose banks would fill thousands of flip-flops with a multiplexer in
front of each bit that is read. Here the banks of a core are two memories, one of transmittances and one of sums. A word holds
both levels of a block's pixel. An op reads its block's word, and writes it with its own level changed. The loops through a bank
still close in one cycle::

    cycle             0     1     2     3     4     5
    transmittances        <read><write>
    pixel (T)                           < T  >              the word that the op has left
    sums                                      < read, write >
    pixel (sums)                                    <sums>

The word of transmittances is read a cycle before its op needs it, into a register, which gets the word that the op before
leaves where both are of one block. The multiplier of the transmittance then begins at registers beside it, and neither the
memory nor the wires to its address are in the slowest loop of the core.

The word that an op leaves is registered. A drain therefore needs no read port of its own. Beside the memories there is one
register for each bank, which says whether its pixel has stopped: `stopped` looks at all banks at once.

Ports, latencies and results are those of `rtl.vrc_array.row`.
"""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib.memory import Memory

from rtl.select import select
from rtl.vrc_array.pixel_core import PixelCore, place_layout
from rtl.vrc_array.row import VrcRow
from spec.config import AcceleratorConfig
from spec.tables import t_stop


def _check(config: AcceleratorConfig) -> None:
    """Raises ValueError where the banks of a machine are in registers."""
    if not config.bank_memories:
        raise ValueError(f"bank_memories must be True, not {config.bank_memories!r}")


class MemoryCore(PixelCore):
    """A pixel core whose banks are in memories that are read without a clock.

    Parameters and ports: those of PixelCore. `draining_block` and `drained_block` must be the blocks of the ops in cycles 3 and
    5, which VrcRow makes them: the core shows no others.

    Storage: a word for each block, of the transmittances of all levels, and another one of their sums.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__(config)
        _check(config)

    def _words(self, m: Module, name: str, width: int, block: Value, write_block: Value) -> tuple[list[Value], Any]:
        """A memory of one number of `width` bits for each block and level. Returns the numbers of `block`, by level, and the
        write port, whose address is `write_block`."""
        levels = self.config.level_banks
        m.submodules[name] = memory = Memory(shape=width * levels, depth=self.config.blocks, init=[])
        read, write = memory.read_port(domain="comb"), memory.write_port()
        # An index has a bit even where there is one block.
        m.d.comb += [read.addr.eq(block[: len(read.addr)]), write.addr.eq(write_block[: len(write.addr)])]
        return [read.data.word_select(level, width) for level in range(levels)], write

    def _blend(self, m: Module, keep: Value, covered: Value) -> tuple[list[Signal], Value, Signal]:
        """Stage 2, as PixelCore's. The bank that it returns is the transmittance after the op, from a register."""
        n, op, first = self.config.formats, self.blend_op, self._first()
        frac, width, levels = n.alpha.frac_bits, n.transmittance.width, range(self.config.level_banks)
        stored, write = self._words(m, "transmittances", width, self.alpha_op.block, op.read.block)
        words = [Signal(width, name=f"word{level}", reset_less=True) for level in levels]
        held, before, after = Signal(width), Signal(width), Signal(width)
        touch, afresh, changes = Signal(), Signal(), Signal()
        m.d.comb += [
            held.eq(select(op.write, words) & op.read.held.replicate(width)),
            before.eq(held | first.replicate(width)),
            touch.eq(op.last | covered & ~(op.read.held & (held < t_stop(n)))),
            afresh.eq(first & (op.last | ~covered)),
            changes.eq(first | touch & ~op.last),
            after.eq((before * keep + (1 << frac - 1) >> frac) | afresh.replicate(width)),
        ]
        shown = [Signal(width, name=f"shown{level}", reset_less=True) for level in levels]
        left = [Mux(op.write[level] & changes, after, words[level]) for level in levels]
        m.d.comb += [write.en.eq(op.write.any() & changes), write.data.eq(Cat(left))]
        # The op behind is of the same block. An op that writes nothing leaves the word as it is stored.
        again = Signal()
        m.d.comb += again.eq(self.alpha_op.block == op.read.block)
        m.d.sync += [word.eq(Mux(again, new, old)) for word, new, old in zip(words, left, stored, strict=True)]
        m.d.sync += [register.eq(value) for register, value in zip(shown, left, strict=True)]
        m.d.comb += [self.pixel[level].transmittance.eq(shown[level]) for level in levels]

        bank, was = Signal(width, reset_less=True), Signal(self._finest.width, reset_less=True)
        began, touched = Signal(reset_less=True), Signal(reset_less=True)
        m.d.sync += [
            bank.eq(select(op.write, left)), was.eq(held >> n.transmittance.frac_bits - self._finest.frac_bits),
            began.eq(first), touched.eq(touch | first)]
        self._stop(m, changes, bank < t_stop(n))
        return [bank], was | began.replicate(len(was)), touched

    def _stop(self, m: Module, changes: Value, stops: Value) -> None:
        """Tells of every bank whether the last op that changed it left its transmittance below the limit. `stops` says so of
        the op that has left the blend stage, from a register, so that the comparison is not behind the multiplier."""
        block = Signal.like(self.blend_op.read.block, reset_less=True)
        m.d.sync += block.eq(self.blend_op.read.block)
        for level, stopped in enumerate(self.stopped):
            every = (1 << self.config.blocks) - 1  # as a core says whose banks are registers that begin at 0
            below = Signal(self.config.blocks, name=f"below{level}", init=every, reset_less=True)
            changed, now = Signal(name=f"changed{level}"), Signal(self.config.blocks, name=f"now{level}")
            m.d.sync += [changed.eq(self.blend_op.write[level] & changes), below.eq(now)]
            m.d.comb += [now[b].eq(Mux(changed & (block == b), stops, below[b])) for b in range(self.config.blocks)]
            m.d.comb += stopped.eq(now.all())

    def _sums(self, m: Module, weight: Value, fine: Value, touched: Value) -> list[list[Signal]]:
        """Stage 4, as PixelCore's. Returns no banks: they are in a memory."""
        op, products = self.sum_op, self._products(weight, fine)
        width = sum(sum_format.width for _, _, sum_format, _ in products)
        words, write = self._words(m, "sums", width, op.read.block, op.read.block)
        left: list[list[Value]] = [[] for _ in words]
        start = 0
        for s, (product, shift, sum_format, outputs) in enumerate(products):
            held = [word[start : start + sum_format.width] for word in words]
            start += sum_format.width
            total = Signal(sum_format.width + shift, name=f"total{s}")
            before = select(op.write, held) & op.read.held.replicate(sum_format.width)
            m.d.comb += total.eq(Cat(Const(1 << shift - 1, shift), before) + product)
            for level, output in enumerate(outputs):
                shown = Signal(sum_format.width, name=f"shown{s}_{level}", reset_less=True)
                value = Mux(op.write[level] & touched, total >> shift, held[level])
                left[level].append(value[: sum_format.width])
                m.d.sync += shown.eq(value)
                m.d.comb += output.eq(shown)
        m.d.comb += [write.en.eq(op.write.any() & touched), write.data.eq(Cat(*left))]
        return []


class MemoryRow(VrcRow):
    """A row of pixel cores whose banks are in memories. Parameters and ports: those of VrcRow."""

    _core = "memory_core", MemoryCore

    def __init__(self, config: AcceleratorConfig):
        super().__init__(config)
        _check(config)

    def _look_ahead(self, core: Any, op: list[Any]) -> list[Any]:
        """Tells a core the block of the op in the alpha stage."""
        return [core.alpha_op.block.eq(self._block(op[1]))]

    def _block(self, op: Any) -> Value:
        """The block of an op."""
        return op.bank >> self.config.level_banks - 1

    def _banks(self, m: Module, op: list[Any], valid: list[Value]) -> tuple[dict[int, Any], dict[int, Any], Signal]:
        """Block and one-hot level in cycles 2 to 4, and in cycle 3 whether an op leaves a transmittance."""
        config = self.config
        read = {cycle: Signal(place_layout(config), name=f"read{cycle}", reset_less=True) for cycle in (2, 3, 4)}
        write = {cycle: Signal(config.level_banks, name=f"write{cycle}") for cycle in (2, 3, 4)}
        left = Signal(reset_less=True)
        level = Cat(op[1].bank[0] == number for number in range(2)) if config.level_banks == 2 else Const(1, 1)
        m.d.sync += [
            read[2].block.eq(self._block(op[1])), read[2].held.eq(self._reads(op[1])),
            write[2].eq(Mux(self._writes(op[1], valid[1]), level, 0)), left.eq(~op[2].last)]
        for cycle in (3, 4):
            m.d.sync += [read[cycle].eq(read[cycle - 1]), write[cycle].eq(write[cycle - 1])]
        return read, write, left
