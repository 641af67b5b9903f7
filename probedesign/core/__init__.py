"""Base of all packages: frames, units, errors, files, statistics and tables; none knows a probe."""
