//! Every reader against changed, cut and lying files, and against the format crates of the field on good ones.

#![allow(clippy::format_collect, reason = "small texts, read once")]
#![allow(clippy::case_sensitive_file_extension_comparisons, reason = "the names are this file's own")]

use palpate::geometry::{Point, PointCloud, Raster, TriangleMesh, Vector};
use palpate::io::{
    parse_cloud, parse_color, parse_depth_png, parse_mask, parse_mesh, parse_npy, read_mesh, write_cloud, write_color,
    write_depth_png, write_mask, write_mesh, write_npy,
};
use proptest::prelude::*;
use std::io::Cursor;
use std::path::Path;
use std::sync::LazyLock;

/// A bumpy closed mesh: an octahedron, divided twice.
fn mesh() -> TriangleMesh {
    let corners =
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    let mut points: Vec<Point> = corners.map(Point::from).to_vec();
    let mut faces = Vec::new();
    for (x, y, z) in [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)] {
        let middle = points.len() as u32;
        points.push(Point::from(
            (points[x as usize].coords + points[y as usize].coords + points[z as usize].coords) * 0.4,
        ));
        faces.extend([[x, y, middle], [y, z, middle], [z, x, middle]]);
    }
    let mut mesh = TriangleMesh::new(points, faces).expect("valid indices");
    mesh.colors = Some((0..mesh.vertices.len()).map(|i| [i as u8 * 17, 255 - i as u8, 3]).collect());
    mesh
}

fn written(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join(name);
    write(&path);
    std::fs::read(&path).expect("written")
}

fn pcd(data: &str) -> Vec<u8> {
    use pcd_rs::{DataKind, DynRecord, Field, FieldDef, Schema, ValueKind, WriterInit};
    let kind = match data {
        "ascii" => DataKind::Ascii,
        "binary" => DataKind::Binary,
        _ => DataKind::BinaryCompressed,
    };
    let field = |name: &str, kind| FieldDef { name: name.into(), kind, count: 1 };
    let floats = ["x", "y", "z", "normal_x", "normal_y", "normal_z"].map(|n| field(n, ValueKind::F32));
    let fields = floats.into_iter().chain([field("rgb", ValueKind::U32)]).collect();
    let init = WriterInit {
        width: 14,
        height: 1,
        viewpoint: pcd_rs::ViewPoint::default(),
        data_kind: kind,
        schema: Some(Schema { fields }),
        version: None,
    };
    let mut out = Cursor::new(Vec::new());
    let mut writer = init.build_from_writer::<DynRecord, _>(&mut out).expect("a writer");
    for (i, p) in mesh().vertices.iter().enumerate() {
        let mut record: Vec<Field> = p.iter().map(|&x| Field::F32(vec![x as f32])).collect();
        record.extend([0.0, 1.0, 0.0].map(|n| Field::F32(vec![n])));
        record.push(Field::U32(vec![0x10_20_00 + i as u32]));
        writer.push(&DynRecord(record)).expect("pushed");
    }
    writer.finish().expect("finished");
    out.into_inner()
}

/// Name and content of one good file of every kind.
static FILES: LazyLock<Vec<(&'static str, Vec<u8>)>> = LazyLock::new(|| {
    let mesh = mesh();
    let normals = vec![Vector::z(); mesh.vertices.len()];
    let cloud = PointCloud { points: mesh.vertices.clone(), normals: Some(normals), colors: mesh.colors.clone() };
    let mut files = Vec::new();
    for name in ["m.ply", "m.obj", "m.stl"] {
        files.push((name, written(name, |p| write_mesh(p, &mesh).expect("written"))));
    }
    files.push(("c.ply", written("c.ply", |p| write_cloud(p, &cloud).expect("written"))));
    let points: String = mesh.vertices.iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
    let faces: String = mesh.faces.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n")).collect();
    let (n, m) = (mesh.vertices.len(), mesh.faces.len());
    files.push(("m.off", format!("OFF\n{n} {m} 0\n{points}{faces}").into_bytes()));
    let head = format!(
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nelement face {m}\nproperty list uchar int vertex_indices\nend_header\n"
    );
    files.push(("a.ply", format!("{head}{points}{faces}").into_bytes()));
    let facets: String = (0..m)
        .map(|f| {
            let corners: String =
                mesh.triangle(f).iter().map(|p| format!("vertex {} {} {}\n", p.x, p.y, p.z)).collect();
            format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
        })
        .collect();
    files.push(("a.stl", format!("solid a\n{facets}endsolid a\n").into_bytes()));
    for data in ["ascii", "binary", "binary_compressed"] {
        files.push(("c.pcd", pcd(data)));
    }
    let map = [0.5f32, -0.25, 1e-3, 0.0, 2.0, 3.0];
    files.push(("m.npy", written("m.npy", |p| write_npy(p, &[2, 3], &map).expect("written"))));
    let depth = Raster::from_fn(9, 7, |r, c| 0.4 + 0.01 * (r * c) as f32);
    files.push(("depth.png", written("d.png", |p| write_depth_png(p, &depth, 1e-4).expect("written"))));
    files.push(("mask.png", written("m.png", |p| write_mask(p, &depth.map(|z| *z > 0.5)).expect("written"))));
    let color = depth.map(|z| [(z * 255.0) as u8, 7, 200]);
    files.push(("color.png", written("c.png", |p| write_color(p, &color).expect("written"))));
    files
});

/// Parses with the reader of that kind; what is read must be consistent, and no larger than the file explains.
fn read(name: &str, bytes: &[u8]) -> bool {
    let path = Path::new(name);
    if name.ends_with(".npy") {
        return parse_npy(path, bytes).map(|a| assert!(a.values.len() <= bytes.len())).is_ok();
    }
    if name.ends_with(".png") {
        let depth = parse_depth_png(path, bytes, 0.001).is_ok();
        return [parse_mask(path, bytes).is_ok(), parse_color(path, bytes).is_ok(), depth].contains(&true);
    }
    let cloud = parse_cloud(path, bytes).map(|file| {
        let cloud = file.cloud;
        assert!(cloud.points.iter().flat_map(|p| p.iter()).all(|x| x.is_finite()));
        assert!(cloud.normals.is_none_or(|n| n.len() == cloud.points.len()));
        assert!(cloud.colors.is_none_or(|c| c.len() == cloud.points.len()));
    });
    if name.ends_with(".pcd") || name == "c.ply" {
        return cloud.is_ok();
    }
    let mesh = parse_mesh(path, bytes).map(|mesh| {
        assert!(mesh.faces.iter().flatten().all(|&i| (i as usize) < mesh.vertices.len()));
        assert!(mesh.faces.len() <= bytes.len() && mesh.vertices.len() <= bytes.len());
    });
    mesh.is_ok()
}

#[test]
fn the_good_files_are_good() {
    for (name, bytes) in FILES.iter() {
        assert!(read(name, bytes), "{name}");
    }
}

#[test]
fn every_cut_of_a_binary_file_is_an_error() {
    // Text may lose its last digit and still be a file; what states its length may not lose a byte.
    for (name, bytes) in FILES.iter().filter(|(n, b)| {
        !(n.starts_with("a.")
            || n.ends_with(".obj")
            || n.ends_with(".off")
            || b.windows(10).any(|w| w == b"DATA ascii"))
    }) {
        // A PNG ends with a checksum and an empty chunk that carry no pixel.
        let last = if name.ends_with(".png") { bytes.len() - 20 } else { bytes.len() };
        for end in 0..last {
            assert!(!read(name, &bytes[..end]), "{name} cut at {end} of {}", bytes.len());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Each case changes every file: bytes set, a stretch removed or doubled, the end cut.
    #[test]
    fn changed_bytes_never_panic(
        sets in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        digit in any::<(prop::sample::Index, u8)>(),
        stretch in any::<(prop::sample::Index, u8, bool)>(),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        for (name, good) in FILES.iter() {
            let mut bytes = good.clone();
            for (at, value) in &sets {
                let at = at.index(bytes.len());
                bytes[at] = *value;
            }
            // Numbers in headers are where the lies are: change a digit to another.
            let digits: Vec<usize> = (0..bytes.len().min(400)).filter(|&i| bytes[i].is_ascii_digit()).collect();
            if !digits.is_empty() {
                bytes[digits[digit.0.index(digits.len())]] = b'0' + digit.1 % 10;
            }
            let from = stretch.0.index(bytes.len());
            let to = (from + usize::from(stretch.1 % 16)).min(bytes.len());
            if stretch.2 {
                bytes.drain(from..to);
            } else {
                let copy = bytes[from..to].to_vec();
                bytes.splice(from..from, copy);
            }
            if let Some(cut) = &cut {
                bytes.truncate(cut.index(bytes.len().max(1)));
            }
            read(name, &bytes);
        }
    }

    /// Any numbers at all in the places of a header.
    #[test]
    fn lying_headers_never_panic(a: u64, b: u64, c: u32, small in 0u64..40) {
        for n in [a, small, u64::MAX] {
            for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
                let ply = format!("ply\nformat {format} 1.0\nelement vertex {n}\nproperty float x\nproperty double y\nproperty list uint uchar l\nproperty float z\nelement face {b}\nproperty list int int vertex_indices\nend_header\n1 2 3 4 5 6 7 8 9 0 1 2 3 4 5 6 7 8 9");
                read("m.ply", ply.as_bytes());
            }
            for data in ["ascii", "binary", "binary_compressed"] {
                let pcd = format!("VERSION .7\nFIELDS x y z _\nSIZE 4 8 4 1\nTYPE F F I U\nCOUNT 1 1 1 {b}\nWIDTH {n}\nHEIGHT {c}\nPOINTS {n}\nDATA {data}\n0123456789012345678901234567890123456789");
                read("c.pcd", pcd.as_bytes());
                read("c.pcd", pcd.replace(&format!("COUNT 1 1 1 {b}\n"), "").as_bytes());
            }
            read("m.off", format!("OFF\n{n} {b} 0\n0 0 0\n1 0 0\n0 1 0\n{c} 0 1 2\n").as_bytes());
            read("m.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {n}\nf -1 -2 -{c}\n").as_bytes());
            let mut stl = vec![0; 84 + 60];
            stl[80..84].copy_from_slice(&c.to_le_bytes());
            read("m.stl", &stl);
            let shape = format!("{{'descr': '<f8', 'fortran_order': True, 'shape': ({n}, {b}, {c}), }}\n");
            let mut npy = b"\x93NUMPY\x01\x00".to_vec();
            npy.extend((shape.len() as u16).to_le_bytes());
            npy.extend(shape.as_bytes());
            npy.extend([0; 32]);
            read("m.npy", &npy);
        }
    }
}

/// Bytes of a good file by name.
fn good(name: &str) -> &'static [u8] {
    &FILES.iter().find(|(n, _)| *n == name).expect("listed").1
}

#[test]
fn the_crates_of_the_field_read_what_we_write() {
    let mesh = mesh();
    let parser = ply_rs_bw::parser::Parser::<ply_rs_bw::ply::DefaultElement>::new();
    let ply = parser.read_ply(&mut Cursor::new(good("m.ply"))).expect("a valid PLY");
    assert_eq!((ply.payload["vertex"].len(), ply.payload["face"].len()), (mesh.vertices.len(), mesh.faces.len()));

    let stl = stl_io::read_stl(&mut Cursor::new(good("m.stl"))).expect("a valid STL");
    assert_eq!((stl.vertices.len(), stl.faces.len()), (mesh.vertices.len(), mesh.faces.len()));

    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(good("m.obj")), &tobj::LoadOptions::default(), |_| {
        Err(tobj::LoadError::GenericFailure)
    })
    .expect("a valid OBJ");
    assert_eq!(models.iter().map(|m| m.mesh.indices.len()).sum::<usize>(), 3 * mesh.faces.len());

    let npy = npyz::NpyFile::new(good("m.npy")).expect("a valid npy");
    assert_eq!(npy.shape(), [2, 3]);
    assert_eq!(npy.into_vec::<f32>().expect("floats")[1], -0.25);
}

#[test]
fn we_read_what_the_crates_of_the_field_write() {
    for data in ["ascii", "binary", "binary_compressed"] {
        let file = parse_cloud(Path::new("c.pcd"), &pcd(data)).expect(data);
        let vertices = mesh().vertices;
        let far = file.cloud.points.iter().zip(&vertices).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(far < 1e-7 && file.cloud.len() == vertices.len(), "{data}: {far}");
        assert_eq!(file.cloud.normals.expect("normals")[3], Vector::y());
        assert_eq!(file.cloud.colors.expect("colours")[9], [0x10, 0x20, 9]);
    }
}

#[test]
fn the_meshes_of_the_field_are_read_whole() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    if !data.is_dir() {
        eprintln!("SKIPPED the_meshes_of_the_field_are_read_whole: {} is absent", data.display());
        return;
    }
    let expected = [
        ("ycb/006_mustard_bottle.ply", 8194, 16384),
        ("meshes/armadillo.obj", 43243, 86482),
        ("meshes/bunny.off", 3485, 6966),
        ("meshes/20mm-xyz-cube.stl", 0, 260),
    ];
    for (file, vertices, faces) in expected {
        let mesh = read_mesh(data.join(file)).expect(file);
        assert_eq!(mesh.faces.len(), faces, "{file}");
        assert!(vertices == 0 || mesh.vertices.len() == vertices, "{file}: {}", mesh.vertices.len());
    }
    let table = palpate::io::read_cloud_file(data.join("clouds/table_scene_mug_stereo_textured.pcd")).expect("a cloud");
    assert_eq!(table.cloud.len() + table.dropped, 640 * 480);
    assert!(table.dropped > 0 && table.cloud.colors.is_some());
}
