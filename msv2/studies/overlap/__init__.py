"""What it is worth to run the first phase of a frame beside the second phase of the one before (`perf.overlap`)."""
