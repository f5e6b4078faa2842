"""Sensors: IMU and magnetometer in the capsule, Hall array, and magnetic localization.

`sensors.Sensors` selects and configures them; `imu` and `hall` simulate their readings; `localize`
estimates the pose of the capsule from one reading of a Hall array, `tracking` over time with the
Kalman filter of `pose_filter`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
