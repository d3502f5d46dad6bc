"""Tests of the whole machine (`rtl.top`), with a memory and a host around it, on whole frames.

    memory          the parameters of an AXI4 memory in Verilog, ideal or LPDDR3 (memory.sv, lpddr3.sv); memory_check and
                    lpddr3_check test it alone
    device          the machine and the memory as one design
    player          plays frames through it; `frames` is its part in the simulator's process
    axi_small       plays small frames with independent AXI models (cocotbext-axi); `axi_frames` is its part in the simulator
    stimuli*        small scenes and their golden frames, of one eye and of two
    planned         a frame with its expected results; `plan_stereo` plans frames of two eyes, `plan_buckets` frames that leave
                    bounds of depth to the next one
    check*          comparison of pixels and counters with the golden renderer
    suite           the test plans
"""
