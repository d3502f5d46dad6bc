"""A row of a tile as one LLVM vector of 16 int32, for numba kernels. Arithmetic wraps around, whatever vectors the CPU has.

Numba widens its own integers to int64, vectorises a loop only if LLVM judges it worthwhile, and turns a table lookup into 16
loads. Here `+ - * & >>` and `>=` work on whole rows, and an integer operand beside a row stands for 16 copies of it.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 16

_LANE = ir.IntType(32)
_VECTOR = ir.VectorType(_LANE, LANES)


class Row(types.Type):
    """The numba type of a row."""

    def __init__(self) -> None:
        super().__init__(name="Row")


row = Row()


@register_model(Row)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, _VECTOR)


def _spread(builder, value, kind):
    """A row unchanged, or an integer copied into all 16 lanes."""
    if isinstance(kind, Row):
        return value
    lane = builder.trunc(value, _LANE) if value.type.width > _LANE.width else value
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), lane, ir.Constant(_LANE, 0))
    return builder.shuffle_vector(one, one, ir.Constant(_VECTOR, [0] * LANES))


def _binary(operation, generate) -> None:
    """Defines the operator `operation` for rows; `generate` takes an IR builder and two vectors."""

    @infer_global(operation)
    class _Typing(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and any(a == row for a in args) and all(isinstance(a, (Row, types.Integer)) for a in args):
                return signature(row, *args)
            return None

    def lower(_context, builder, sig, args):
        return generate(builder, *(_spread(builder, value, kind) for value, kind in zip(args, sig.args, strict=True)))

    for kinds in ((Row, Row), (Row, types.Integer), (types.Integer, Row)):
        lower_builtin(operation, *kinds)(lower)


_binary(operator.add, ir.IRBuilder.add)
_binary(operator.sub, ir.IRBuilder.sub)
_binary(operator.mul, ir.IRBuilder.mul)
_binary(operator.and_, ir.IRBuilder.and_)
_binary(operator.rshift, ir.IRBuilder.ashr)
_binary(operator.ge, lambda builder, a, b: builder.sext(builder.icmp_signed(">=", a, b), _VECTOR))  # -1 where true, else 0


def _true(builder, mask):
    return builder.icmp_signed("!=", mask, ir.Constant(_VECTOR, [0] * LANES))


def _pointer(context, builder, kind, array, at):
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())


@intrinsic
def load(_context, array, at):
    """The row at element `at` of a flat int32 array."""

    def generate(context, builder, sig, args):
        return builder.load(_pointer(context, builder, sig.args[0], *args), align=4)

    return row(array, types.intp), generate


@intrinsic
def store(_context, array, at, value):
    """Stores a row at element `at` of a flat int32 array."""

    def generate(context, builder, sig, args):
        builder.store(args[2], _pointer(context, builder, sig.args[0], *args[:2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, row), generate


@intrinsic
def ramp(_context):
    """The row 0, 1 .. 15."""
    return row(), lambda *_: ir.Constant(_VECTOR, list(range(LANES)))


@intrinsic
def choose(_context, mask, a, b):
    """`a` where `mask` is true, `b` elsewhere."""

    def generate(_, builder, sig, args):
        a, b = (_spread(builder, value, kind) for value, kind in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(_true(builder, args[0]), a, b)

    return row(mask, a, b), generate


@intrinsic
def any_lane(_context, mask):
    """Whether `mask` is true in any lane."""

    def generate(_, builder, __, args):
        bits = builder.bitcast(_true(builder, args[0]), ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(mask), generate


@intrinsic
def lookup(_context, table, index):
    """table[index] for two rows, with indices 0..15; a single permutation where the CPU has one."""

    def generate(_, builder, __, args):
        table, index = args
        found = ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            place = ir.Constant(_LANE, lane)
            found = builder.insert_element(found, builder.extract_element(table, builder.extract_element(index, place)), place)
        return found

    return row(table, index), generate
