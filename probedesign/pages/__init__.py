"""Reports as pages: one HTML file each, read without a network and printed on A4."""
