"""A simulated Net F/T box: a probe in a scene of objects, streamed over real sockets in the protocol of the box."""
