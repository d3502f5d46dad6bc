"""`python -m msv2.verilog` is `msv2 verilog`."""

from msv2.verilog.command import main
from spec.errors import run_command_line

run_command_line(main)
