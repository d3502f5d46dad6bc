"""Tests of the bus units: the AXI master, driven by test clients against memories of many behaviours, and the host's registers.

    device      the Verilog designs that are simulated
    memory      an AXI memory that pauses, reorders and fails, and checks that the master keeps the protocol
    master      test scenarios of the master; this module runs in the simulator's process
    registers   test scenarios of the register file; this module runs in the simulator's process
    watch       checks on the master that hold in every cycle
    suite       the test plans of both units
"""
