"""Generate maps: offices, caves, halls, mazes, rooms and warehouses."""
