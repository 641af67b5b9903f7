"""A Net F/T box that is not there: the rod in a scene of objects, told over real sockets as the real box tells it."""
