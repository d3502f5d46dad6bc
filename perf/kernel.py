"""The decorators of the model's kernels. `golden.kernels` keeps their compiled code, like that of all kernels."""

from __future__ import annotations

from golden.kernels import compiled

kernel = compiled(error_model="numpy")
"""The decorator of a function of the model."""

phase = compiled(error_model="numpy", _nrt=False)
"""The decorator of a kernel that creates no array, so that numba does not count references; counting them would take most of
its time."""

step = compiled(inline="always", error_model="numpy")
"""The decorator of a part of a phase, which numba inlines into it."""
