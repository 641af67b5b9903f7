"""Reports of predictions, comparisons, identifications and validations: HTML pages and PNG pictures."""
