"""Sources of wrench readings: Net F/T box, DAQ card, recordings, ROS 2 bags and a simulation."""
