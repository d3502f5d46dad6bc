"""Proofs by the folders of rtl/."""
