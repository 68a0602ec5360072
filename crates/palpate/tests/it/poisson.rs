//! Screened Poisson makes a closed manifold of any cloud with normals: `PALPATE_CASES=5000 cargo test -p palpate --test it poisson` tries more.

use palpate::geometry::{Point, PointCloud, Topology, Vector};
use palpate::surface::{Boundary, PoissonParams, SurfaceError, screened_poisson};
use proptest::prelude::*;

/// Positions that often coincide, line up or fall on lattice planes, with normals in any direction.
fn clouds() -> impl Strategy<Value = PointCloud> {
    let coordinate = prop_oneof![-1.0..1.0, (-4_i32..=4).prop_map(|i| f64::from(i) / 4.0)].boxed();
    let triple = |c: BoxedStrategy<f64>| (c.clone(), c.clone(), c).prop_map(|(x, y, z)| Vector::new(x, y, z));
    let normal = triple((-1.0..1.0).boxed()).prop_filter("a direction", |n: &Vector| n.norm() > 0.1);
    proptest::collection::vec((triple(coordinate), normal), 4..150).prop_map(|samples| {
        let points = samples.iter().map(|(p, _)| Point::from(*p)).collect();
        let normals = samples.iter().map(|(_, n)| n.normalize()).collect();
        PointCloud::with_normals(points, normals).expect("one normal a point")
    })
}

/// 48 clouds, or as many as `PALPATE_CASES` says.
fn cases() -> u32 {
    std::env::var("PALPATE_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(48)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_clouds_give_closed_manifolds(
        cloud in clouds(),
        depth in prop_oneof![Just(None), (2_u32..=7).prop_map(Some)],
        neumann in any::<bool>(),
        screening in prop_oneof![Just(None), (0.0..20.0).prop_map(Some)],
    ) {
        let boundary = if neumann { Boundary::Neumann } else { Boundary::Dirichlet };
        let params = PoissonParams { depth, screening, boundary, ..PoissonParams::default() };
        match screened_poisson(&cloud, None, &params) {
            Ok(surface) => {
                let topology = Topology::of(&surface.mesh);
                prop_assert!(topology.is_watertight() && topology.is_vertex_manifold(), "{topology:?}");
                prop_assert_eq!((topology.degenerate_faces, topology.unused_vertices), (0, 0));
                prop_assert!(surface.mesh.vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
            }
            Err(SurfaceError::TooFewPoints { .. } | SurfaceError::NoSurface { .. }) => {}
            Err(other) => prop_assert!(false, "{other}"),
        }
    }
}
