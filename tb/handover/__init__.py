"""Unit test of the buffers between sorting unit and array (`rtl.sort_tmu.handover`): the same items, in order, how soon.

    suite       what is run, in which configurations
"""
