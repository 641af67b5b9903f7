"""Commands of `probedesign`, one module per command or per group of related ones."""
