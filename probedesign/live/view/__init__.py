"""What a person sees of a run: a local page in three dimensions, and a terminal, with the same words."""
