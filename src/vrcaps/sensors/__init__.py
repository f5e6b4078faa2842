"""Sensors: IMU and magnetometer in the capsule, Hall array, and magnetic localization.

`sensors.Sensors` says which there are; `imu`, `magnetometer` and `hall` simulate their readings;
`localize` estimates the pose of the capsule from one reading of a Hall array, `tracking` over time
by the Kalman filter of `pose_filter`.
"""
