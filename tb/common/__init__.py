"""What every testbench shares: the runner, record codec, patterns of pauses, drivers and the memory-backed player.

    runner      builds and runs simulations (Verilator under cocotb)
    emission    emitted Verilog, kept
    codec       bit patterns to files and back
    patterns    when a port pauses
    playback    a Verilog testbench that plays files into a unit's streams and records what comes out: whole frames
    player      plays recordings through it; recordings is the part in the simulator's process
    streams     sources and sinks driven from Python, cycle by cycle: small units
"""
