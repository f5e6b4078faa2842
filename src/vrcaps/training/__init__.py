"""Training runs: their folders and the threads that they use."""
