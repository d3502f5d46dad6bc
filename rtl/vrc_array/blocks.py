"""Issues ops to the array. It holds back drains, and passes an array smaller than a tile over the tile block by block.

With several blocks every op is issued once for each block, in row-major order. Its polynomial is moved to the first pixel of
the block by exact forward differences; from block to block along x::

    exponent += step_x      step_x += cores_x^2 curve_xx      slope_x += cores_x curve_xx      slope_y += cores_x curve_xy

where step_x = cores_x slope_x + cores_x (cores_x - 1) / 2 curve_xx is the difference over a block. From one row of blocks to
the next it works likewise, starting from saved values of the row's first block. All sizes are powers of two, so that additions
are enough.
"""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.fixed import modular
from rtl.pipeline import Pipeline
from rtl.shapes import layout
from rtl.vrc_array.expand import issue_layout
from spec.config import AcceleratorConfig
from spec.records import pixel_op


class BlockSequencer(wiring.Component):
    """Turns each op of a tile into one op per block.

    Parameters:
        config: the machine.

    Ports:
        ops: ops, whose polynomials are given at the tile's first pixel.
        may_drain: an op with `drain` may be issued now.
        issue: the registered output; `issue.op.valid` low is a bubble. It has no back-pressure.
        issued: strobe; an op is issued, and `issue` shows it in the next cycle.
        draining: strobe; the same for an op with `drain`.
        waits: an op with `drain` is held back in this cycle because `may_drain` is low.

    Throughput: one block of an op per cycle, without a gap between ops. Order is kept. Latency: 1 cycle; 3 with several blocks.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__(self._ports())

    def _ports(self) -> dict[str, wiring.Member]:
        return {
            "ops": In(stream.Signature(layout(pixel_op(self.config)))),
            "may_drain": In(1),
            "issue": Out(issue_layout(self.config)),
            "issued": Out(1),
            "draining": Out(1),
            "waits": Out(1),
        }

    def _free(self, op: Any) -> Value:
        """Whether the op may be issued now."""
        return ~op.drain | self.may_drain

    def _held(self, op: Any) -> Value:
        """Whether a valid op at the input must wait, where there is one block."""
        return self.ops.valid & op.drain & ~self.may_drain

    def elaborate(self, platform: object) -> Module:
        m = Module()
        if self.config.blocks == 1:
            op = self.ops.payload
            m.d.comb += [
                self.ops.ready.eq(self._free(op)), self.waits.eq(self._held(op))]
            polynomial = {name: op[name] for name in ("exponent", "slope_x", "slope_y")}
            self._issue(m, self.ops.valid & self.ops.ready, op, polynomial, None)
        else:
            self._sequence(m)
        return m

    def _issue(self, m: Module, strobe: Value, op: Any, polynomial: dict[str, Value], block: Value | None) -> None:
        """Registers the op at `issue`, for one block."""
        out = self.issue
        m.d.comb += [self.issued.eq(strobe), self.draining.eq(strobe & op.drain)]
        m.d.sync += out.op.valid.eq(strobe)
        with m.If(strobe):
            m.d.sync += [out[name].eq(value) for name, value in polynomial.items()]
            m.d.sync += [out.curve_xx.eq(op.curve_xx), out.curve_xy.eq(op.curve_xy)]
            m.d.sync += [out.op[name].eq(op[name]) for name in out.op.shape().members if name not in ("valid", "bank")]
            level = op.bank if self.config.level_banks == 2 else Cat()
            m.d.sync += out.op.bank.eq(Cat(level) if block is None else Cat(level, block))

    def _sequence(self, m: Module) -> None:
        """Steps the polynomial from block to block."""
        config = self.config
        wide, high = (config.array_x - 1).bit_length(), (config.array_y - 1).bit_length()
        column, row = Signal(range(config.region // config.array_x)), Signal(range(config.region // config.array_y))
        last_column, last_row = column == config.region // config.array_x - 1, row == config.region // config.array_y - 1
        advance = Signal()
        p = Pipeline(m, load=self.ops.valid & self.ops.ready, advance=advance)
        op, step_x, step_y = self._steps(p, wide, high)
        valid = p.control("valid", self.ops.valid).at(2)
        strobe = valid & self._free(op)
        m.d.comb += [
            advance.eq(~valid | strobe & last_column & last_row), self.ops.ready.eq(advance), self.waits.eq(valid & ~strobe)]

        first = {"exponent": op.exponent, "slope_x": op.slope_x, "slope_y": op.slope_y, "step_x": step_x}
        along_row = {name: Signal.like(value, name=f"{name}_here") for name, value in first.items()}
        of_row = {name: Signal.like(value, name=f"{name}_row") for name, value in first.items()}
        of_row["step_y"] = Signal.like(step_y, name="step_y_row")
        start = (column == 0) & (row == 0)
        here = {name: Mux(start, value, along_row[name]) for name, value in first.items()}
        begin = {name: Mux(start, value, of_row[name]) for name, value in {**first, "step_y": step_y}.items()}
        xx, xy, yy = op.curve_xx, op.curve_xy, op.curve_yy
        next_column = {
            "exponent": here["exponent"] + here["step_x"], "step_x": here["step_x"] + (xx << 2 * wide),
            "slope_x": here["slope_x"] + (xx << wide), "slope_y": here["slope_y"] + (xy << wide),
        }
        next_row = {
            "exponent": begin["exponent"] + begin["step_y"], "step_x": begin["step_x"] + (xy << wide + high),
            "slope_x": begin["slope_x"] + (xy << high), "slope_y": begin["slope_y"] + (yy << high),
            "step_y": begin["step_y"] + (yy << 2 * high),
        }
        with m.If(strobe):
            m.d.sync += column.eq(column + 1)
            m.d.sync += [along_row[name].eq(next_column[name]) for name in along_row]
            with m.If(start):
                m.d.sync += [of_row[name].eq(value) for name, value in begin.items()]
            with m.If(last_column):
                m.d.sync += [column.eq(0), row.eq(Mux(last_row, 0, row + 1))]
                m.d.sync += [along_row[name].eq(next_row[name]) for name in along_row]
                m.d.sync += [of_row[name].eq(value) for name, value in next_row.items()]
        polynomial = {name: here[name] for name in ("exponent", "slope_x", "slope_y")}
        self._issue(m, strobe, op, polynomial, Cat(column, row))

    def _steps(self, p: Pipeline, wide: int, high: int) -> Any:
        """The op after two stages, with the differences of its exponent over a block along x and along y."""
        n, op = self.config.formats, p.data("op", self.ops.payload)

        def step(name: str, slope: Value, curve: Value, shift: int) -> Any:
            half = p.reg(f"{name}_half", lambda c: (c << 2 * shift - 1) - (c << shift - 1), p.data("curve", curve))
            return p.reg(name, lambda h, s: modular(h + (s << shift), n.exponent), half, p.data("slope", slope)).at(2)

        payload = self.ops.payload
        return op.at(2), step("step_x", payload.slope_x, payload.curve_xx, wide), step(
            "step_y", payload.slope_y, payload.curve_yy, high)
