"""Exploration by several robots that share what they know."""
