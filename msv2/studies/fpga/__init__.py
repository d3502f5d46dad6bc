"""What units take on FPGAs, by Yosys: measure (one unit, in a process of its own), study (all units, and the page)."""
