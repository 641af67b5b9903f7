"""Where the base is: from a file, a bag or the robot itself, by the clock of the wrench."""
