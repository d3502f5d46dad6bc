"""Units placed with coloquinte: what their wires cost."""
