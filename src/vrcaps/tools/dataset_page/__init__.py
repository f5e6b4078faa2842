"""The page that shows what a data set holds: counts, histograms, a mosaic of frames."""
