"""Reports of explorations of a volume."""
