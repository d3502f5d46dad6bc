"""Compares machines on the same frames: cycles, energy and traffic, as pictures and as a page (`msv2 study run
performance`)."""
