"""Camera calibration from photographs of a chessboard: corners, fit, report."""
