"""Complete controllers for common tasks, with tested parameters."""
