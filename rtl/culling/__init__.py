"""Culling and conversion: Gaussians to splats, and the dataflow engine that its units are made with.

    dataflow    a unit's arithmetic as a graph of operations
    schedule    when each operation starts and what keeps each value, for one slot every `interval` cycles
    retime      fewest registers for one slot a cycle
    datapath    the graph as hardware between two streams
    values      combinational logic between operations

    near, projection, projection_unit   points to splats that may touch a tile of the frame
    tile_test   splats to tile entries; its parts: tile_runs (rows and runs of a splat's box), level_table (of the tiles),
                tile_columns (the ellipse test), tile_expand (runs to entries, the foveation filter)
    colour      splats with an entry to views in memory; its parts: harmonics (the basis), fixed_multiply, colour_sum, views
    frame       ports for settings, counts of a frame's items
    compare     one unit at full rate against several that take turns (`python -m rtl.culling.compare`)

A unit is a graph and the interval at which slots (points, splats, runs of tiles) enter::

    g = Dataflow()
    x, y = g.input("x", VIEW), g.input("y", VIEW)
    focal = g.setting("focal", VIEW)                        # an In port, constant during a frame
    slope = g.divide(x, y, VIEW)
    larger = g.logic("larger", VIEW, lambda a, b: Mux(a > b, a, b), slope, g.constant(1.5, VIEW))
    g.output("pixels", g.to_fixed(g.mul(larger, focal, VIEW), MEAN2D))
    unit = Datapath(g, interval=4, carried=unsigned(24))

Operations (`to` is the result's format; every one is rounded once, as rtl.float says):

    add(a, b, to)  sub(a, b, to)  mul(a, b, to)  divide(a, b, to)  reciprocal(a, to)  rsqrt(a, to)  sqrt(a, to)
    to_fixed(a, to, rounding)  to_float(a, to)
    logic(name, to, fn, *operands)      combinational fn of the operands' Values, registered at its end; `to` a format or shape;
                                        with lets=True fn(let, ...) names what it uses more than once
    view(name, to, fn, operand)         the same of one operand, wiring only: no register, no cycle (a field, a sign flipped)
    input(name, to)  setting(name, to)  settings(name, to, count)  constant(value, to)  output(name, node)

`Datapath` has the streams `sink` (payload: the inputs, and `carried`) and `source` (the outputs, and `carried`), and a port for
every setting. Whoever builds for several intervals writes the graph once.
"""
