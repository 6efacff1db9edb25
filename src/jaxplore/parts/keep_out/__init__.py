"""Areas that robots must not enter."""
