"""Reports of explorations by fleets."""
