//! From what a laboratory records to the numbers that the rest needs: a camera's model and place, a gel's colours and scale, and
//! where on the robot a sensor sits.

pub mod camera;
pub mod gel;
pub mod sensor_pose;
