"""The single source of truth: number formats, record layouts, constants, ROM tables and configurations.

Imports numpy and nothing of ours. `golden` and `rtl` both read it and never each other.
"""
