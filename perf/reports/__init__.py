"""Machines beside each other on the same frames: cycles, energy, traffic; pictures, a page (`python -m perf.report`)."""
