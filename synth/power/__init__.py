"""Energy of mapped netlists: what every cell does in a simulation of real work, times what the library says that costs.

    cells      functions, capacitances, delays and energies of library cells, from their liberty files
    netlist    mapped modules, flattened to arrays
    memories   what the memories that synthesis leaves out do
    electrical loads, slews, delays and energies of every gate of a netlist
    simulate   cycles of a flat netlist: settled values, toggles, glitches
    energy     toggles to picojoules, by unit and kind
"""
