"""A synthetic campaign: what a laboratory would have measured of a probe whose truth is known."""
