"""Sweeps: the cycle model, area and energy over many settings of machine, frame and memory."""
