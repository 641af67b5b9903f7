"""The studio: a page in the browser on which a probe is designed by moving sliders and looking."""
