"""Fusion of depth images into a surface, with poses given or estimated by odometry."""
