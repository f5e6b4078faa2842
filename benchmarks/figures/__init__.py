"""Pages of results: all sections, and the summary."""
