"""Experiments, from settings."""
