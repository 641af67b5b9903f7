"""A series of touches from a moving base into points of the world with their ellipsoids."""
