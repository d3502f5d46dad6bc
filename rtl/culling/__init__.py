"""Projection, tile test and colours of Gaussians, and the dataflow engine from which these units are made.

    dataflow    a unit's arithmetic as a graph of operations
    schedule    the cycle in which each operation starts, and the registers that hold each value, for one slot every `interval`
                cycles
    retime      the schedule with the fewest registers for one slot per cycle
    datapath    the graph as hardware between two streams
    values      combinational logic between operations

    near, projection, projection_unit   turn Gaussians into splats that may touch a tile of the frame
    eyes        what surrounds them in machines with joint frames: Gaussians for both eyes, and their culls
    tile_test   turns splats into intersections; its parts are tile_runs (rows and runs of a splat's box), level_table (the
                levels of the tiles), tile_columns (the ellipse test) and tile_expand (runs to intersections, the foveation
                filter)
    colour      computes the colours of splats with an intersection and writes splat records to memory; its parts are harmonics
                (the basis functions), fixed_multiply, colour_sum and views, or with compact records compact_sum and
                compact_views
    frame       ports for settings, and counts of a frame's items
    compare     compares one unit at full rate with several that take turns (`python -m rtl.culling.compare`)

A slot is one item on its way through a unit: a Gaussian, a splat or a run of tiles. A unit is described by a graph and the
interval at which slots enter::

    g = Dataflow()
    x, y = g.input("x", VIEW), g.input("y", VIEW)
    focal = g.setting("focal", VIEW)                        # an In port, constant during a frame
    slope = g.divide(x, y, VIEW)
    larger = g.logic("larger", VIEW, lambda a, b: Mux(a > b, a, b), slope, g.constant(1.5, VIEW))
    g.output("pixels", g.to_fixed(g.mul(larger, focal, VIEW), MEAN2D))
    unit = Datapath(g, interval=4, carried=unsigned(24))

These are the operations. `to` is the format of the result, which is rounded once, as rtl.float says:

    add(a, b, to)  sub(a, b, to)  mul(a, b, to)  divide(a, b, to)  reciprocal(a, to)  rsqrt(a, to)  sqrt(a, to)
    to_fixed(a, to, rounding)  to_float(a, to)
    logic(name, to, fn, *operands)      combinational fn of the operands' Values, with a register at its output; `to` is a
                                        format or a shape; with lets=True, fn(let, ...) names values that it uses more than once
    view(name, to, fn, operand)         wiring only, of one operand: it takes no register and no cycle (a field, a flipped sign)
    input(name, to)  setting(name, to)  settings(name, to, count)  constant(value, to)  output(name, node)

`Datapath` has the streams `sink` (payload: the inputs, and `carried`) and `source` (payload: the outputs, and `carried`), and a
port for every setting. One graph serves for all intervals.
"""
