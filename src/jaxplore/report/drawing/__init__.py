"""Drawing functions that all reports share."""
