"""The loop on a real robot: from scans and odometry to checked commands, without any middleware."""
