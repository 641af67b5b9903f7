"""Other solvers of the rod, used as their documentation recommends.

All solve the same problem: a cone clamped at s = 0 without a rigid root, under gravity and one dead force.
"""
