"""The open door to the Verilog: any unit of any machine as files that another project can compile.

    export      `export(config, out_dir, unit, prefix)` writes the files
    command     `msv2 verilog`, the command line
    modules     the modules of a unit, with plain names and without memories
    names       names that need no escape
    memories    memories as modules of their own, and their behavioural models
    ports       what the ports carry, as comments
    streams     the streams and the maps of their payloads, as a page and for the JSON
    lint        what Verilator's -Wall is told not to warn of, and why
    rtlil       RTLIL as text
"""
