"""Slow decisions: where to go next, and how a reference is followed there."""
