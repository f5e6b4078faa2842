"""Tasks on images: depth, segmentation, classification, super-resolution and motion."""
