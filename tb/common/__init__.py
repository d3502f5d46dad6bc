"""Code that all testbenches share.

    runner      builds and runs simulations (Verilator under cocotb)
    emission    a cache of emitted Verilog
    codec       converts bit patterns to files and back
    patterns    tables of the cycles in which a port pauses
    bench       a component that holds a unit and has the ports that `playback` needs
    playback    a Verilog testbench that plays files into a unit's streams and records its outputs; fast enough for whole frames
    player      runs recordings through that testbench; `recordings` is its part in the simulator's process
    exact       plans of runs whose outputs are known in advance, and their comparison
    memory      a memory model for units that read and write memory
    framed      starts frames in the bench of a unit that writes a frame to memory, and models when the memory is idle
    streams     sources and sinks driven from Python, cycle by cycle, for small units
    scenes      frames of real scenes from the golden renderer, as stimuli
"""
