"""Small scenes and cameras for the tests of the integer renderer: those of the hard cases."""

from msv2.cases.makers import map_for, random_model, splats, turned_view, view
from spec.constants import SH_C0

__all__ = ["SH_C0", "map_for", "random_model", "splats", "turned_view", "view"]
