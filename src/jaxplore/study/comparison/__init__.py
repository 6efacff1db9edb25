"""Comparison of variants: in one scenario, or on all maps of a folder."""
