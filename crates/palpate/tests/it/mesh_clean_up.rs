//! The clean-up of meshes answers for any triangle soup: `PALPATE_CASES=5000 cargo test -p palpate --test it mesh_clean_up` tries more.

use palpate::geometry::{
    Point, Topology, TriangleMesh, decimated, drop_small_pieces, largest_piece, repaired, taubin_smoothed,
};
use palpate::surface::fill_holes;
use proptest::prelude::*;

/// Faces between vertices that often coincide or line up: edges of many faces, faces without area, twice the same face, pieces that touch in a point.
fn soups() -> impl Strategy<Value = TriangleMesh> {
    let coordinate = prop_oneof![(-2_i32..=2).prop_map(f64::from), -1.0..1.0, Just(1e9), Just(1e-300)].boxed();
    let vertex = (coordinate.clone(), coordinate.clone(), coordinate).prop_map(|(x, y, z)| Point::new(x, y, z));
    proptest::collection::vec(vertex, 3..20).prop_flat_map(|vertices| {
        let corner = 0..vertices.len() as u32;
        let face = [corner.clone(), corner.clone(), corner];
        proptest::collection::vec(face, 0..60)
            .prop_map(move |faces| TriangleMesh::new(vertices.clone(), faces).expect("corners exist"))
    })
}

fn cases() -> u32 {
    std::env::var("PALPATE_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(64)
}

/// Finite, and every corner names a vertex.
fn is_sound(mesh: &TriangleMesh) -> bool {
    let count = mesh.vertices.len() as u32;
    mesh.vertices.iter().all(|v| v.iter().all(|c| c.is_finite())) && mesh.faces.iter().flatten().all(|&v| v < count)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_soup_is_cleaned_up(soup in soups(), target in 0_usize..30, share in 0.0..1.0_f64) {
        let (mesh, _) = repaired(&soup);
        let topology = Topology::of(&mesh);
        prop_assert!(is_sound(&mesh) && topology.degenerate_faces == 0 && topology.unused_vertices == 0, "{topology:?}");
        let closed = fill_holes(&mesh);
        prop_assert!(is_sound(&closed));
        if topology.is_consistently_oriented() {
            let filled = Topology::of(&closed);
            prop_assert!(filled.boundary_edges == 0 && filled.non_manifold_edges == 0, "{filled:?}");
        }
        let fewer = decimated(&mesh, target);
        prop_assert!(is_sound(&fewer) && fewer.faces.len() <= mesh.faces.len());
        for made in [taubin_smoothed(&mesh, 5), drop_small_pieces(&mesh, share), largest_piece(&mesh)] {
            prop_assert!(is_sound(&made) && made.faces.len() <= mesh.faces.len());
        }
        // Unrepaired, too.
        for made in [fill_holes(&soup), decimated(&soup, target), taubin_smoothed(&soup, 5), largest_piece(&soup)] {
            prop_assert!(is_sound(&made));
        }
    }
}
