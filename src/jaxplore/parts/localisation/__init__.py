"""A robot that does not know its pose: odometry with errors, and how it finds itself."""
