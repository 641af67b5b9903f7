"""Processing between source and output: blocks of readings, filter, tare, touch monitoring and estimates."""
