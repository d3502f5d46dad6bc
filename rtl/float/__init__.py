"""Arithmetic of small floats, correctly rounded, one result a cycle.

    number      fields, normalising shifts, rounding and packing: what the units are made of
    unit        the units' ports and valid pipeline
    add         sum and difference
    multiply    product
    convert     from and to fixed point
    seed        tables of first approximations
    roots       reciprocal, reciprocal square root, square root

Every unit gives the exact result rounded once, HALF_EVEN, flushed and saturated as `spec.formats.SmallFloat` says, whatever
formats its operands and its result have.
"""
