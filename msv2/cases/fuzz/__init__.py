"""Fuzzing of everything that reads other people's files: spoilt files of every format, each loaded within limits."""
