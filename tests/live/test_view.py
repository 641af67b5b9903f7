"""What the views show: shape, ellipsoid, words; nothing sure where nothing is."""
