"""Mutants of Python: small faults in `spec/` and in the integer renderer, and which of the quick tests notice them."""
