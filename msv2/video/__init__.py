"""Films of a scene along a camera path, drawn by the integer renderer, with the machine's numbers under each frame."""
