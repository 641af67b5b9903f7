"""Validation of a frozen probe against a reference, as Table I of the paper, and of its stated covariances."""
