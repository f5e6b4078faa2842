"""Magnetic actuation: controller, pose solver, actuators, targets and paths.

`steering_program` holds the settings (`MagnetSteering`) and runs `magnet_controller` in closed
loop. `magnet_pose_solver` computes the magnet pose for a wrench; `magnet_actuator` moves it, freely
or by a robot of `arm/`; `wall_path` plans targets.
"""
