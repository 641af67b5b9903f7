"""The other ways to solve the rod, each as its user would write it, with care and without tricks.

All solve the very same case: a bare cone, clamped at s = 0, under gravity and one dead force. None is part of
the package. Exudyn and PyElastica come with `pip install '.[bench]'`; their files import them.
"""
