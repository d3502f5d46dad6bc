"""Energies of units that do real work: mapped netlists are simulated with golden stimuli, and every output is compared.

    gates       runs a unit's test bench on its mapped netlist
    netlists    flattened mapped netlists of units
    work        the units, the scenes that they play, and the operations that are counted
    measure     energies in picojoules by unit
    table       reports/energy_per_operation.json, which the study `energy` reads
"""
