"""Cycle model of the machine, driven by golden frames.

    trace       what of a golden frame the machine's timing depends on
    model       cycles, stalls, beats and a timeline of a trace on a machine with a memory
    validate    the model beside the RTL
"""
