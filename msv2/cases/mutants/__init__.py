"""Mutants: a unit's circuit with one small fault, which the unit's suite must notice."""
