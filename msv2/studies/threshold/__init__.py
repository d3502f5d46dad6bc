"""What selective warping is worth: the threshold's table, its plot, and what warping costs."""
