"""Settings of every test: property tests draw the same examples each run; the clock judges none."""

from hypothesis import settings

settings.register_profile("probedesign", deadline=None, max_examples=100, derandomize=True)
settings.load_profile("probedesign")
