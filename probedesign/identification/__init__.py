"""From measurements to numbers: E, G and their kin by least squares on the full rod."""
