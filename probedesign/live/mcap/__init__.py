"""Recordings in MCAP: standard ROS 2 messages in a file that survives its writer."""
