"""Metrics, figures and animation of an exploration run."""
