"""Statics of the flexible part as a Cosserat rod: equilibria, their sensitivities, and contacts."""
