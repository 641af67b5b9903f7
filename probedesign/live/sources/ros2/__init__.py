"""Wrenches and poses of a running ROS 2 system, through a bridge process."""
