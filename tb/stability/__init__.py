"""The hard cases on the machine, and the command that runs all of them everywhere.

`rtl` plays the golden frames of `golden.stability` through the machine, `streams` adds the cases of the machine alone, `faults`
drops guards in hardware, `report` prints and writes, `python -m tb.stability` is the command line.
"""
