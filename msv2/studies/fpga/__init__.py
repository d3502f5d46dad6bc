"""What units take on two families of FPGAs, by Yosys: measure (one unit, in a process of its own), study (all, and the page)."""
