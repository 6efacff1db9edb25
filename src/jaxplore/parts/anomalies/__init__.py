"""What differs from the known map."""
