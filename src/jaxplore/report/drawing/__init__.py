"""Drawing that all reports share."""
