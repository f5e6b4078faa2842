//! Magnetic actuation: the pose of a magnet for a wrench, the reference that a capsule follows, and
//! the kinematics of the robot arm that carries a magnet. In double precision and SI units.

pub mod arm_chain;
pub mod arm_with_payload;
mod damped_least_squares;
mod inverse_kinematics;
mod kinematic_chain;
mod link_capsules;
pub mod magnet_pose_solver;
pub mod reference;
pub mod robot_actuator;
pub mod rotation;
