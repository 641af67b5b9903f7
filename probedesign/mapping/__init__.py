"""Mapping: locates the points of an object that a probe touches from a moving base, with their covariances."""
