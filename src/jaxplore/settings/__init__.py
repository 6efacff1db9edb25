"""Settings of a run: sections of checked values, from YAML or the command line."""
