"""ROS 2: conversions of messages, the node that drives a robot, and a simulated robot."""
