"""The ATI Net F/T box: wire protocol, configuration, and the source `netft://`."""
