"""The Net F/T box as its clients see it: the wire, its own configuration, and `netft://` over both."""
