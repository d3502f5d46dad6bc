"""What packed frames (`spec.packed`) save on frames of real scenes."""
