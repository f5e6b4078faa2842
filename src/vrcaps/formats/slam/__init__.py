"""Formats of visual SLAM and odometry: TUM RGB-D, KITTI, EuRoC, VSLAM-LAB."""
