"""Energy of units doing real work: mapped netlists simulated with golden stimuli, every output compared.

    gates       a run of a unit's bench on its mapped netlist
    netlists    mapped netlists of units, flat
    work        what is played: units, scenes, and the operations that are counted
    measure     picojoules by unit, into reports/energy_per_operation.json
"""
