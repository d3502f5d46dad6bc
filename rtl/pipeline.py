"""Pipelines that align the operands of their operations by themselves.

A `Staged` value knows how many registers lie between the pipeline's input and itself. `Pipeline.reg` delays its operands to the
latest of their stages, applies combinational logic and registers the result. So a unit reads as a list of operations, one per
stage, and nobody counts delays by hand.
"""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Const, Module, Signal, Value, ValueCastable, ValueLike


class Staged:
    """A value that is valid `stage` registers after its pipeline's input. All users of a delayed copy share its registers."""

    def __init__(self, pipeline: Pipeline, name: str, value: Value | ValueCastable, stage: int, control: bool) -> None:
        self._pipeline, self._name, self._control = pipeline, name, control
        self._next: Staged | None = None
        self.value, self.stage = value, stage

    def to(self, stage: int) -> Staged:
        """The same value delayed to `stage`. Raises ValueError where that lies before its own stage."""
        if stage < self.stage:
            raise ValueError(f"stage of {self._name} must be at least {self.stage}, not {stage!r}")
        if stage == self.stage:
            return self
        if self._next is None:
            self._next = self._pipeline._register(self._name, self.value, self.stage, self._control)
        return self._next.to(stage)

    def at(self, stage: int) -> Value | ValueCastable:
        """The Amaranth value, delayed to `stage` as by `to`."""
        return self.to(stage).value

    def map(self, logic: Callable[[Value], ValueLike]) -> Staged:
        """The result of combinational `logic` of the value, at the same stage."""
        return Staged(self._pipeline, self._name, Value.cast(logic(self.value)), self.stage, self._control)


class Pipeline:
    """The registers of one pipeline. One slot per cycle enters, and leaves after as many cycles as there are stages.

    A slot that does not `load` moves on without clocking data registers, which keep the data of the slot before it. So a bubble
    causes no switching, and a slot may also mean "the same data once more".

    Args:
        module: the module that gets the registers.
        load: whether the slot at the input brings data.
        advance: all stages move in cycles in which it is high; constant 1 for a pipeline that never waits.
    """

    def __init__(self, module: Module, *, load: ValueLike, advance: ValueLike = 1) -> None:
        self._module, self._advance = module, Value.cast(advance)
        self._load = Staged(self, "load", Value.cast(load), 0, True)

    def data(self, name: str, value: ValueLike) -> Staged:
        """A value at the input that is valid in slots that load. Its registers have no reset."""
        return Staged(self, name, value if isinstance(value, ValueCastable) else Value.cast(value), 0, False)

    def control(self, name: str, value: ValueLike) -> Staged:
        """A value at the input that is valid in every slot. Its registers are reset to 0."""
        return Staged(self, name, value if isinstance(value, ValueCastable) else Value.cast(value), 0, True)

    def reg(self, name: str, logic: Callable[..., ValueLike], *operands: Staged) -> Staged:
        """The registered result of `logic`, applied to the operands delayed to the latest of their stages. The result is
        control if any operand is."""
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
