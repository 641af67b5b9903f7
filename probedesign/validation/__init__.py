"""Errors of the frozen probe against a reference, as the paper's Table I has them, and whether stated ones come true."""
