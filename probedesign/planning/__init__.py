"""Planning of a campaign: the tests that determine the parameters of a print best in the time available."""
