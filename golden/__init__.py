"""The golden model: scenes, metrics, oracle, host, integer renderer, differentiable renderer, training."""
