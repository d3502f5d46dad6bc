"""Whole frames through the RTL of the rendering array, compared with the golden renderer bit for bit."""
