"""The decorators of the model's kernels, whose compiled code is kept as that of all kernels is."""

from __future__ import annotations

from golden.kernels import compiled

kernel = compiled(error_model="numpy")
"""A function of the model."""

phase = compiled(error_model="numpy", _nrt=False)
"""A kernel that makes no array, so that none needs its references counted: that would take most of its time."""

step = compiled(inline="always", error_model="numpy")
"""A part of a phase, compiled into it."""
