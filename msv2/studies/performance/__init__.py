"""Compares machines on the same frames: cycles, energy and traffic, as pictures and as a page (`python -m msv2.studies
performance`)."""
