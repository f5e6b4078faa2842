"""A camera from photographs of a chessboard: corners, fit, report."""
