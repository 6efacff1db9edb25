"""Exact ray traversal."""
