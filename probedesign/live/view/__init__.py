"""Views of a run: a local 3D page and a table in the terminal, with the same status lines."""
