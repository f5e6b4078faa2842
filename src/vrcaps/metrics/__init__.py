"""Pure NumPy measures of images, depth, poses and shapes."""
