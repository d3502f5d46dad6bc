"""Tests of the units in `rtl.supertiles`."""
