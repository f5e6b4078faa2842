//! Motion and resistance of the wall: Winkler foundation, drag, spring wall, finite elements.

pub mod drag;
pub mod fem;
pub mod spring_wall;
pub mod winkler_foundation;
