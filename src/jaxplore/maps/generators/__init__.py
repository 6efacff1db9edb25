"""Generated maps: offices, caves, halls, mazes, rooms, warehouses."""
