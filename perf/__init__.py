"""The cycle model of the machine. It takes its input from golden frames.

    trace       the properties of a golden frame on which the machine's timing depends
    plan        the trace on a particular machine: groups, chunks, cache misses, addresses
    model       cycles, stalls, beats and a timeline of a trace, on a machine with a memory
    geometry, render, and the modules that they import: the units, stepped cycle by cycle
    gscore      a cycle estimate of a machine like GSCore, for comparison
"""
