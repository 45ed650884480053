"""What can be seen of a run: recordings for a viewer, pictures and films, plots."""
