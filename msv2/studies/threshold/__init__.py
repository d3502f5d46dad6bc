"""The value of selective warping: the table of thresholds, its plot, and the cost of warping."""
