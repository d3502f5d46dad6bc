"""The single source of truth: number formats, record layouts, constants, ROM tables and configurations.

This package imports numpy and nothing else of the project. `golden` and `rtl` both read it, and never each other.
"""
