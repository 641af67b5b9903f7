"""How fast the program is beside the other ways to do the same. Not tests: nothing here asserts on time."""
