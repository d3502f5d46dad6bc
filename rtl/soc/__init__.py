"""A small system around the machine for an FPGA: a RISC-V core with its firmware, a serial line, and one port to memory."""
