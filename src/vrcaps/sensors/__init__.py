"""Sensors: IMU and magnetometer in the capsule, Hall array, and magnetic localization."""
