"""Pipelines whose operands align themselves.

A `Staged` value knows how many registers lie behind it. `Pipeline.reg` delays its operands to the latest of their stages,
applies combinational logic and registers the result, so that a unit reads as the list of its operations, one a stage,
and no delay is counted by hand.
"""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Const, Module, Signal, Value, ValueCastable, ValueLike


class Staged:
    """A value valid `stage` registers after its pipeline's input. Delayed copies are shared by all who ask."""

    def __init__(self, pipeline: Pipeline, name: str, value: Value | ValueCastable, stage: int, control: bool) -> None:
        self._pipeline, self._name, self._control = pipeline, name, control
        self._next: Staged | None = None
        self.value, self.stage = value, stage

    def to(self, stage: int) -> Staged:
        """The same slot's value at a stage not before its own."""
        if stage < self.stage:
            raise ValueError(f"stage of {self._name} must be at least {self.stage}, not {stage!r}")
        if stage == self.stage:
            return self
        if self._next is None:
            self._next = self._pipeline._register(self._name, self.value, self.stage, self._control)
        return self._next.to(stage)

    def at(self, stage: int) -> Value | ValueCastable:
        """The value at `stage`, as `to`."""
        return self.to(stage).value

    def map(self, logic: Callable[[Value], ValueLike]) -> Staged:
        """Combinational `logic` of the value, at the same stage."""
        return Staged(self._pipeline, self._name, Value.cast(logic(self.value)), self.stage, self._control)


class Pipeline:
    """The registers of one pipeline: one slot a cycle enters, and leaves after as many cycles as there are stages.

    A slot that does not `load` moves on without clocking data registers, which keep the slot before it: a bubble costs no
    switching, and a slot may also stand for "the same data once more".

    Args:
        module: where the registers go.
        load: whether the slot now at the input brings data.
        advance: every stage moves where it is high; constant 1 for a pipeline that never waits.
    """

    def __init__(self, module: Module, *, load: ValueLike, advance: ValueLike = 1) -> None:
        self._module, self._advance = module, Value.cast(advance)
        self._load = Staged(self, "load", Value.cast(load), 0, True)

    def data(self, name: str, value: ValueLike) -> Staged:
        """A value at the input that only slots which load bring; no reset."""
        return Staged(self, name, value if isinstance(value, ValueCastable) else Value.cast(value), 0, False)

    def control(self, name: str, value: ValueLike) -> Staged:
        """A value at the input that every slot brings; reset to 0."""
        return Staged(self, name, value if isinstance(value, ValueCastable) else Value.cast(value), 0, True)

    def reg(self, name: str, logic: Callable[..., ValueLike], *operands: Staged) -> Staged:
        """`logic` of the operands, brought to the latest of their stages, and registered; control if any of them is."""
        stage = max(operand.stage for operand in operands)
        value = logic(*(operand.at(stage) for operand in operands))
        value = value if isinstance(value, ValueCastable) else Value.cast(value)
        return self._register(name, value, stage, any(operand._control for operand in operands))

    def _register(self, name: str, value: Value | ValueCastable, stage: int, control: bool) -> Staged:
        register = Signal(value.shape(), name=f"{name}_{stage + 1}", reset_less=not control)
        enable = self._advance if control else self._advance & self._load.at(stage)
        if isinstance(enable, Const) and enable.value:
            self._module.d.sync += register.eq(value)
        else:
            with self._module.If(enable):
                self._module.d.sync += register.eq(value)
        return Staged(self, name, register, stage + 1, control)
