"""What accuracy buys on machines with lists by super-tile: harmonics, points and support radius given up, against cycles."""
