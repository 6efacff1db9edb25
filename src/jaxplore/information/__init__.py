"""Expected information of beams, scans and trajectories, and fields of it over a whole map."""
