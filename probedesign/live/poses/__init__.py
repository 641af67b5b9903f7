"""Poses of the base from a file, a ROS 2 bag or a robot, by the clock of the wrench."""
