"""Objects and their classes."""
