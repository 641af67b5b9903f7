"""From a design to a print: the rules it must keep, and PreForm that prints it. No CAD, no mechanics."""
