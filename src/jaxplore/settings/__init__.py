"""Settings: every number of a run, checked."""
