"""Magnetic actuation: controller, pose solver, actuators, targets and paths.

`steering_program` holds the settings (`MagnetSteering`) and runs `magnet_controller` in closed
loop. `magnet_pose_solver` computes the magnet pose for a wrench; `magnet_actuator` and
`robot_actuator` (with an arm of `arm/`) move it; `point_to_point` and `wall_path` plan targets.
"""
