"""The robot's belief: its map, the fields derived from it, and the obstacles that it tracks."""
