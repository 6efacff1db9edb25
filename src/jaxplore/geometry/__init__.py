"""Angles and exact ray traversal."""
