"""What to simulate: one typed tree, and its files."""
