"""Robots that differ from their model, from episode to episode."""
