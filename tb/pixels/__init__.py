"""Tests of packed frames' units against the golden renderer: the packer of the machine and the unpacker of a display."""
