"""Magnetic actuation: controller, pose solver, actuators, targets and paths.

`steering_program` says what to do (`MagnetSteering`) and runs `magnet_controller` in closed loop;
`magnet_pose_solver` places the magnet for a wrench; `magnet_actuator` and `robot_actuator` carry
it, the second with an arm of `arm/`; `point_to_point` and `wall_path` plan targets.
"""
