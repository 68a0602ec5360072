use super::draw::{Fragment, Fragments, Kind, draw};
use super::occlusion::{Light, lighting};
use super::{Item, Viewpoint, palette};
use crate::geometry::{Point, Raster, Vector};
use rayon::prelude::*;

/// Samples per pixel and axis.
const SUPERSAMPLING: usize = 2;
/// Side of the shadow map, samples.
const SHADOW_RESOLUTION: usize = 1024;

/// Draws the items as seen from a viewpoint.
///
/// A key light from the upper left with a soft shadow, a weak fill light from the right, and sky light dimmed by ambient
/// occlusion; the ground is as white as the paper and shows only what falls on it.
pub fn render_scene(items: &[Item], viewpoint: &Viewpoint) -> Raster<[u8; 3]> {
    let view = viewpoint.supersampled(SUPERSAMPLING);
    let mut picture = draw(items, &view, 0.7 * SUPERSAMPLING as f64);
    let camera_from_world = view.world_from_camera.rotation.inverse();
    let up = camera_from_world * view.up;
    let towards_light = (up + Vector::new(-0.5, 0.0, -0.5)).normalize();
    let light = view.seen_by_light(&(view.world_from_camera.rotation * towards_light), SHADOW_RESOLUTION);
    let shadow = draw(items, &light, 1.0);
    lay_ground(&mut picture, &view);
    let lights = lighting(&picture, &view, &shadow, &light);

    let (width, height) = (viewpoint.camera.width, viewpoint.camera.height);
    let mut pixels = vec![[0; 3]; width * height];
    pixels.par_chunks_mut(width).enumerate().for_each(|(row, line)| {
        for (col, pixel) in line.iter_mut().enumerate() {
            let mut sum = [0.0; 3];
            for r in row * SUPERSAMPLING..(row + 1) * SUPERSAMPLING {
                for c in col * SUPERSAMPLING..(col + 1) * SUPERSAMPLING {
                    let index = r * picture.cols + c;
                    let ray = view.ray(c as f64, r as f64);
                    let mut light = lights[index];
                    if picture.data[index].kind == Kind::Ground {
                        light = light.faded(edge_fade(row, height) * edge_fade(col, width));
                    }
                    let color = shaded(&picture.data[index], light, &ray, &up, &towards_light);
                    for i in 0..3 {
                        sum[i] += color[i];
                    }
                }
            }
            *pixel = sum.map(|s| to_srgb(s / (SUPERSAMPLING * SUPERSAMPLING) as f32));
        }
    });
    Raster::from_vec(height, width, pixels).expect("one colour per pixel was made")
}

/// Fills what is left with the ground as far as it matters: where the view looks down on it.
fn lay_ground(picture: &mut Fragments, view: &Viewpoint) {
    let eye = Point::from(view.world_from_camera.translation.vector);
    let up = view.world_from_camera.rotation.inverse() * view.up;
    let drop = view.ground - view.up.dot(&eye.coords);
    let farthest = ((view.center - eye).norm() + 3.0 * view.extent) as f32;
    let cols = picture.cols;
    picture.data.par_chunks_mut(cols).enumerate().for_each(|(row, line)| {
        for (col, fragment) in line.iter_mut().enumerate() {
            let descent = up.dot(&view.ray(col as f64, row as f64));
            let z = (drop / descent) as f32;
            if fragment.kind == Kind::Empty && descent < -0.02 && z > 0.0 && z < farthest {
                let normal = [up.x as f32, up.y as f32, up.z as f32];
                *fragment = Fragment { z, normal, color: palette::PAPER.map(f32::from), kind: Kind::Ground };
            }
        }
    });
}

/// 0 at the picture's border, 1 from a tenth of it inwards: a shadow must not end in a hard edge.
fn edge_fade(index: usize, size: usize) -> f32 {
    let inwards = index.min(size - 1 - index) as f32 / (0.1 * size as f32);
    let t = inwards.min(1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Linear light of a sample.
fn shaded(fragment: &Fragment, light: Light, ray: &Vector, up: &Vector, towards_light: &Vector) -> [f32; 3] {
    let albedo = match fragment.kind {
        Kind::Empty => palette::PAPER.map(|c| to_linear(f32::from(c))),
        _ => fragment.color.map(to_linear),
    };
    match fragment.kind {
        Kind::Empty | Kind::Unlit => albedo,
        Kind::Ground => {
            let shade = (1.0 - 0.42 * (1.0 - light.key)) * (1.0 - 0.75 * (1.0 - light.ambient));
            albedo.map(|a| a * shade)
        }
        Kind::Lit => {
            let n = Vector::from(fragment.normal.map(f64::from));
            let key = n.dot(towards_light).max(0.0) as f32 * light.key;
            let fill = n.dot(&Vector::new(0.8, -0.1, -0.6)).max(0.0) as f32;
            let sky = 0.5 + 0.5 * n.dot(up) as f32;
            // Occlusion is squared: a crevice sees little of the light that bounces, too.
            let ambient = (0.26 + 0.20 * sky) * light.ambient * light.ambient + 0.12 * fill * light.ambient;
            let half = (towards_light - ray.normalize()).normalize();
            let gloss = 0.05 * n.dot(&half).max(0.0).powi(24) as f32 * light.key;
            albedo.map(|a| a * (ambient + 0.78 * key) + gloss)
        }
    }
}

/// Display values are taken as the square root of light: close to sRGB, and cheap.
fn to_linear(value: f32) -> f32 {
    let v = value / 255.0;
    v * v
}

fn to_srgb(light: f32) -> u8 {
    (light.clamp(0.0, 1.0).sqrt() * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{PointCloud, TriangleMesh};
    use crate::render::{Look, Paint, Shape, View};

    /// A square across y, 0.2 m wide, seen from the front; its normal faces −y.
    fn square() -> TriangleMesh {
        let p = |x: f64, z: f64| Point::new(x, 0.0, z);
        let vertices = vec![p(-0.1, 0.0), p(0.1, 0.0), p(0.1, 0.2), p(-0.1, 0.2)];
        TriangleMesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).expect("indices are below 4")
    }

    fn front(items: &[Item]) -> Raster<[u8; 3]> {
        let view = View { look: Look::From { azimuth: 0.0, elevation: 0.0 }, ..View::default() };
        render_scene(items, &Viewpoint::fit(&view, items, (64, 64)).expect("finite points"))
    }

    #[test]
    fn a_square_covers_its_share_of_the_picture_and_nothing_else() {
        let mesh = square();
        let picture = front(&[Item::mesh(&mesh, [200, 40, 40])]);
        let red = picture.pixels().filter(|p| p.2[0] > p.2[1].saturating_add(40)).count() as f64;
        let expected = (0.86 * 64.0_f64).powi(2);
        assert!((red / expected - 1.0).abs() < 0.05, "{red} of {expected}");
        assert_eq!(picture[(1, 1)], palette::PAPER);
    }

    #[test]
    fn the_nearer_of_two_shapes_is_seen_whatever_their_order() {
        let near = square();
        let far = near.transformed(&crate::geometry::Isometry::translation(0.0, 0.05, 0.0));
        let (a, b) = (Item::mesh(&near, [200, 0, 0]), Item::mesh(&far, [0, 0, 200]));
        for items in [[a, b], [b, a]] {
            let middle = front(&items)[(32, 32)];
            assert!(middle[0] > 100 && middle[2] < 60, "{middle:?}");
        }
    }

    #[test]
    fn normals_are_shown_as_colours_of_the_world_frame() {
        let mesh = square();
        let picture = front(&[Item { shape: Shape::Mesh(&mesh), paint: Paint::Normal }]);
        let [r, g, b] = picture[(32, 32)];
        assert!(r.abs_diff(128) <= 1 && g <= 1 && b.abs_diff(128) <= 1, "{:?}", [r, g, b]);
    }

    #[test]
    fn a_face_seen_from_behind_is_darker() {
        let mesh = square();
        let mut turned = mesh.clone();
        for face in &mut turned.faces {
            face.swap(1, 2);
        }
        let brightness =
            |m: &TriangleMesh| front(&[Item::mesh(m, [200; 3])])[(32, 32)].map(u32::from).iter().sum::<u32>();
        assert!(brightness(&turned) + 60 < brightness(&mesh));
    }

    #[test]
    fn discs_close_a_regular_cloud() {
        let points = (0..400).map(|i| Point::new((i % 20) as f64 * 0.01, 0.0, (i / 20) as f64 * 0.01)).collect();
        let cloud = PointCloud { points, normals: Some(vec![-Vector::y(); 400]), colors: None };
        let picture = front(&[Item::cloud(&cloud, [0, 0, 200])]);
        let mut inside = picture.pixels().filter(|p| (10..54).contains(&p.0) && (10..54).contains(&p.1));
        assert!(inside.all(|p| p.2[2] > p.2[0] + 40), "a gap between the discs");
    }

    #[test]
    fn the_same_bytes_for_one_and_two_threads() {
        let mesh = square();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of threads");
            pool.install(|| front(&[Item::mesh(&mesh, palette::MESH)]))
        };
        assert_eq!(with(1), with(2));
    }
}
