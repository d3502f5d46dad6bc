"""Random frames for as many cycles as wanted, each compared with the integer renderer bit by bit."""
