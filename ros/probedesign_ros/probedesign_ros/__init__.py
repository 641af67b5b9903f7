"""The link between a run of `probedesign live` and ROS 2; needs no part of probedesign."""
