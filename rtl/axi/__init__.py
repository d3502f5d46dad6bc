"""Memory ports, the AXI master, the host's registers and counters."""
