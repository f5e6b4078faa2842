"""HTML page of a dataset's contents: counts, histograms, sample frames."""
