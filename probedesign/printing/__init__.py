"""Print rules of a design, and preparation of the print job in PreForm; needs no CAD and no mechanics."""
