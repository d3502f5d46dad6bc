"""Generated documents: formats, registers and effects as pages, and the site."""
