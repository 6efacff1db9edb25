"""Faults that are injected into a run."""
