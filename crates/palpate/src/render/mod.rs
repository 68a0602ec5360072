//! Pictures of meshes and clouds, on the processor alone: depth-buffered triangles and discs, two lights with a soft
//! shadow, ambient occlusion, 2 × 2 supersampling. The same bytes for any number of threads.

mod draw;
mod font;
mod item;
mod occlusion;
mod panels;
mod shade;
mod tactile;
mod view;

pub use item::{Item, Paint, Shape, palette};
pub use panels::{Fit, Panel, render_panels};
pub use shade::render_scene;
pub use tactile::{render_contact, render_indentation};
pub use view::{Look, View, Viewpoint};
