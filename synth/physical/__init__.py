"""Placement of mapped units, and what the wires of a placed unit cost in delay and energy.

    lef.py        sizes and pins of cells
    placement.py  a legal placement of a flat netlist, made by coloquinte
    parasitics.py trees of wires over the pins of a net, and the file of their resistances and capacitances (SPEF)
    clock_tree.py buffers and wires of a clock over placed flip-flops
    wired.py      a unit's timing with and without its wires
"""
