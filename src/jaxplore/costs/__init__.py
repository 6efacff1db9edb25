"""What a controller minimises."""
