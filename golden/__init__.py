"""Golden model: scenes, oracle, integer renderer, metrics, training."""
