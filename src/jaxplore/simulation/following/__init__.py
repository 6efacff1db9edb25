"""The path-following scenario."""
