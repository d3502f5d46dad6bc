#!/bin/sh
# Exports the tile merge unit of the tiny machine and runs testbench.v on it with Icarus Verilog.
#   PYTHON  the Python that has this project (default: python3)     OUT  where files go (default: build/examples/tile_merge_unit)
set -eu
here=$(cd "$(dirname "$0")" && pwd)
out=${OUT:-build/examples/tile_merge_unit}
command -v iverilog >/dev/null || { echo "iverilog is not installed: apt-get install iverilog" >&2; exit 2; }
"${PYTHON:-python3}" -m msv2.verilog --config tiny --unit tile_merge_unit --out "$out"
cd "$out"
iverilog -g2005 -Wall -o testbench.vvp -f tiny_tile_merge_unit.f "$here/testbench.v"
vvp -n testbench.vvp | tee testbench.log
grep -q "^PASS" testbench.log
