"""Which body is best: what a design is worth, over a grid of designs, at the optimum, side by side."""
