"""Arithmetic of small floats, correctly rounded, one result a cycle.

    number      fields, normalising shifts, rounding and packing: what the units are made of
    unit        the units' ports and valid pipeline
    add         sum and difference
    multiply    product
    convert     from and to fixed point
    seed        tables of first approximations
    iteration   what quotients and roots share: table, Newton step, exact residual
    divide      reciprocal and quotient
    roots       square root and its reciprocal

Every unit gives the exact result rounded once, HALF_EVEN, flushed and saturated as `spec.formats.SmallFloat` says, whatever
formats its operands and its result have. That is what one operation in float64 and one rounding give, but for one case: a sum
with an operand longer than the result, which float64 may round to a tie.
"""
