"""`python -m msv2.cases`: the command line of the hard cases."""

from msv2.cases.command import main
from spec.errors import run_command_line

if __name__ == "__main__":
    run_command_line(main)
