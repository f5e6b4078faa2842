"""HTML page of a data set's contents: counts, histograms, sample frames."""
