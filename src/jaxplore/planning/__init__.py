"""Controllers put together for a task."""
