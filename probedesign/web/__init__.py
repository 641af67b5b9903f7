"""What the local pages of `live --view` and of the studio share: their guard, and the probe in three dimensions."""

LOOPBACK = ("127.0.0.1", "localhost", "::1")  #: Names of this machine that no other can reach.
