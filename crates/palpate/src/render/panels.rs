use super::{Item, View, Viewpoint, font, palette, render_scene};
use crate::geometry::{Aabb, Point, Raster};

/// One picture of several side by side.
#[derive(Debug, Clone)]
pub struct Panel<'a> {
    /// What it shows, all in one scene.
    pub items: Vec<Item<'a>>,
    /// Written below it; empty for none.
    pub caption: String,
}

/// Where the panels' viewpoints come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fit {
    /// Shared if the panels show things of about one size in one place, else one each.
    Auto,
    /// One viewpoint fitted to everything shown: place and scale can be compared.
    Shared,
    /// One viewpoint per panel.
    Each,
}

/// Draws panels side by side, each of `size` (width, height) pixels. Captions, if any panel has one, stand in a strip below.
///
/// `None` if there is nothing to see.
pub fn render_panels(panels: &[Panel], view: &View, fit: Fit, size: (usize, usize)) -> Option<Raster<[u8; 3]>> {
    let everything: Vec<Item> = panels.iter().flat_map(|p| p.items.iter().copied()).collect();
    let shared = Viewpoint::fit(view, &everything, size)?;
    let share = match fit {
        Fit::Auto => lie_together(panels),
        Fit::Shared => true,
        Fit::Each => false,
    };
    let captioned = panels.iter().any(|p| !p.caption.is_empty());
    let text_height = caption_height(panels, size);
    let strip = if captioned { (2.0 * text_height).round() as usize } else { 0 };
    let mut picture = Raster::filled(size.1 + strip, size.0 * panels.len(), palette::PAPER);
    for (k, panel) in panels.iter().enumerate() {
        let own = if share { None } else { Viewpoint::fit(view, &panel.items, size) };
        let part = render_scene(&panel.items, &own.unwrap_or(shared));
        for (row, col, &color) in part.pixels() {
            picture[(row, k * size.0 + col)] = color;
        }
        let middle = (k as f64 + 0.5) * size.0 as f64;
        let baseline = size.1 as f64 + 0.5 * (strip as f64 + text_height);
        font::write(&mut picture, &panel.caption, [middle, baseline], text_height, palette::INK);
    }
    Some(picture)
}

/// Whether each panel's box reaches over a third of the box round all of them.
fn lie_together(panels: &[Panel]) -> bool {
    let finite = |p: &&Point| p.iter().all(|c| c.is_finite());
    let bounds = |panel: &Panel| Aabb::of(panel.items.iter().flat_map(Item::points).filter(finite));
    let boxes: Vec<Aabb> = panels.iter().filter_map(bounds).collect();
    let Some(all) = boxes.iter().copied().reduce(|a, b| a.union(&b)) else { return true };
    boxes.iter().all(|b| b.diagonal() > all.diagonal() / 3.0)
}

/// One height for all captions: legible, and small enough for the longest.
fn caption_height(panels: &[Panel], size: (usize, usize)) -> f64 {
    let wanted = (size.1 as f64 / 26.0).clamp(10.0, 40.0);
    let longest = panels.iter().map(|p| font::width(&p.caption, wanted)).fold(1.0, f64::max);
    wanted * (0.94 * size.0 as f64 / longest).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Isometry, TriangleMesh};

    fn tetrahedron() -> TriangleMesh {
        let p = |x: f64, y: f64, z: f64| Point::new(x, y, z) * 0.1;
        let vertices = vec![p(0.0, 0.0, 0.0), p(1.0, 0.0, 0.0), p(0.0, 1.0, 0.0), p(0.0, 0.0, 1.0)];
        TriangleMesh::new(vertices, vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).expect("indices are below 4")
    }

    #[test]
    fn panels_share_one_view_and_captions_get_a_strip() {
        let mesh = tetrahedron();
        let panel = |color, caption: &str| Panel { items: vec![Item::mesh(&mesh, color)], caption: caption.into() };
        let plain = render_panels(&[panel([200; 3], ""), panel([200; 3], "")], &View::default(), Fit::Auto, (60, 50));
        let plain = plain.expect("there is a mesh");
        assert_eq!(plain.shape(), (50, 120));
        assert!(plain.pixels().filter(|p| p.1 < 60).all(|(r, c, color)| *color == plain[(r, c + 60)]));
        let labelled =
            render_panels(&[panel([200; 3], "a mesh"), panel([200; 3], "")], &View::default(), Fit::Auto, (60, 50));
        let labelled = labelled.expect("there is a mesh");
        assert!(labelled.rows() > 60);
        let inked = |left: usize| {
            labelled.pixels().any(|(r, c, color)| r >= 50 && (left..left + 60).contains(&c) && color[0] < 160)
        };
        assert!(inked(0) && !inked(60));
    }

    #[test]
    fn shapes_far_apart_get_a_viewpoint_each() {
        let mesh = tetrahedron();
        let far = mesh.transformed(&Isometry::translation(5.0, 0.0, 0.0));
        let panels = [&mesh, &far].map(|m| Panel { items: vec![Item::mesh(m, [200, 0, 0])], caption: String::new() });
        let red = |fit| {
            let picture = render_panels(&panels, &View::default(), fit, (60, 50)).expect("there is a mesh");
            picture.pixels().filter(|p| p.2[0] > p.2[1].saturating_add(40)).count()
        };
        assert!(red(Fit::Each) > 20 * red(Fit::Shared));
        assert_eq!(red(Fit::Auto), red(Fit::Each));
    }
}
