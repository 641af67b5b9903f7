"""Other solvers of the rod, used as their documentation recommends.

All solve the same problem: a cone clamped at s = 0 without a rigid root, under gravity and one dead force. They are no
part of the package. Exudyn is installed by `pip install '.[bench]'`.
"""
