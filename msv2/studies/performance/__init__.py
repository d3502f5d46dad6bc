"""Machines beside each other on the same frames: cycles, energy, traffic; pictures, a page (`python -m msv2.studies
performance`)."""
