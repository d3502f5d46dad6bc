"""The AXI master and its clients' read queues, the host's registers, and the performance counters."""
