"""Errors of a frozen probe against a reference, as Table I of the paper has them, and whether stated errors hold."""
