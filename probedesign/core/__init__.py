"""Text tables with named units: their lines, their columns. Nothing here knows what they are for."""
