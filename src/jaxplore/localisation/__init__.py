"""Where the robot is: odometry with errors, matching of scans, particle filters."""
