"""Energy of mapped netlists: the activity of every cell in a simulation of real work, times the energies that the library
states.

    cells      functions, capacitances, delays and energies of library cells, from their liberty files
    netlist    mapped modules, flattened to arrays
    memories   the behaviour of the memories that synthesis takes out of the logic
    electrical loads, slews, delays and energies of every gate of a netlist
    simulate   simulates cycles of a flat netlist: settled values, toggles, glitches
    energy     converts toggles to energies, by part of the netlist and by kind
"""
