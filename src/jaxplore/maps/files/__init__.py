"""Map, path and image files, read and written."""
