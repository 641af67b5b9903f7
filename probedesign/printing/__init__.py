"""Print rules of a design; needs no CAD and no mechanics."""
