"""Tests of the units in `rtl.supertiles`."""
"""Tests of the units in `rtl.supertiles`.

    record_fetch_*  record fetch, with the golden decoder and the cache that `golden.msv2_ref.fetch` models
"""
