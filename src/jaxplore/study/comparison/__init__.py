"""Comparison of variants: in one place, or on all maps of a folder."""
