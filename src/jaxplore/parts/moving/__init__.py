"""Obstacles that move on paths, such as people who walk."""
