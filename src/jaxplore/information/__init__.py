"""What a measurement is worth, everywhere at once."""
