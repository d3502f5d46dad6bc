"""Correctly rounded arithmetic of small floats, with one result per cycle.

    number      the parts of the units: fields, normalising shifts, rounding and packing
    unit        the units' ports and valid pipeline
    add         sum and difference
    multiply    product
    convert     conversion from and to fixed point
    seed        tables of first approximations
    iteration   the parts that quotients and roots share: table, Newton step, exact residual
    divide      reciprocal and quotient
    roots       square root and its reciprocal

Every unit gives the exact result rounded once, HALF_EVEN, flushed and saturated as `spec.formats.SmallFloat` says, whatever
formats its operands and its result have. One operation in float64 followed by one rounding gives the same result, with one
exception: where an operand of a sum is longer than the result, float64 may round the exact sum to a tie.
"""
