"""Packed frames: rows of pixels packed into blocks and written to memory, and read back for a display (`spec.packed`)."""
