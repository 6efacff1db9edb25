"""From settings to what is run."""
