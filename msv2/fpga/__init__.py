"""The machine as a bitstream for an FPGA: tools (what is needed), flow (synthesis, place and route), soc (the simulation)."""
