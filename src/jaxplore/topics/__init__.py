"""Topics of a recording for Foxglove: its messages, and what all tasks write."""
