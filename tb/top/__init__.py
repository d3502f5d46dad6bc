"""Whole frames through the whole machine (`rtl.top`): memory and host around it.

    packing     records to the words of memory
    image       what lies where in memory, the settings of a frame, the frame at the end
    memory      a fast AXI4 memory in Verilog
    device      machine and memory between files
    player      plays frames through it; frames is the part in the simulator's process
    axi_small   small frames with independent AXI models (cocotbext-axi)
"""
