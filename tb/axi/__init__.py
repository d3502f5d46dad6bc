"""The bus: AXI master with test clients on memories of all tempers, and the host's registers.

    device      what is simulated
    memory      an AXI memory that pauses, reorders and fails, and checks the master's protocol
    master      scenarios of the master, in the simulator's process
    registers   scenarios of the register file, in the simulator's process
    suite       plans of both
"""
