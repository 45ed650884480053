"""``palanquin watch``: a run in a terminal, while it goes on."""
