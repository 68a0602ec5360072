//! Meshes and clouds by extension, with the checks that every format shares.

use super::error::read_bytes;
use super::ply::{PropertyValues, VertexProperty};
use super::raw::{Raw, VertexValues};
use super::{IoError, atomic_write, glb, obj, off, pcd, ply, stl};
use crate::geometry::{Point, PointCloud, TriangleMesh};
use std::collections::HashMap;
use std::path::Path;

/// Largest coordinate that any unit explains.
const COORDINATE_LIMIT: f64 = 1e9;

/// A cloud and what had to be left out of it.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudFile {
    /// The points with finite coordinates (and finite normals, if there are normals).
    pub cloud: PointCloud,
    /// Points left out: organised clouds mark pixels without a reading as NaN.
    pub dropped: usize,
}

fn extension(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

fn parse(name: &Path, bytes: &[u8], known: &'static str) -> Result<Raw, IoError> {
    let extension = extension(name);
    if !known.split(' ').any(|k| k.strip_prefix('.') == Some(&extension)) {
        return Err(IoError::Extension { path: name.to_owned(), known });
    }
    let (format, raw) = match extension.as_str() {
        "ply" => ("PLY", ply::parse(bytes)),
        "obj" => ("OBJ", obj::parse(bytes)),
        "off" => ("OFF", off::parse(bytes)),
        "stl" => ("STL", stl::parse(bytes)),
        _ => ("PCD", pcd::parse(bytes)),
    };
    raw.map_err(|reason| IoError::malformed(name, format, reason))
}

fn is_sane(p: &Point) -> bool {
    p.iter().all(|x| x.abs() < COORDINATE_LIMIT)
}

/// Reads a triangle mesh by extension: `.ply`, `.obj`, `.off` or `.stl`. Polygons become fans of triangles; STL corners at the
/// same position become one vertex. Units are the file's own.
///
/// # Errors
/// [`IoError`] naming the file and the first thing that is wrong: no faces, a NaN vertex, an index past the vertices, a file
/// that is cut short.
pub fn read_mesh(path: impl AsRef<Path>) -> Result<TriangleMesh, IoError> {
    parse_mesh(path.as_ref(), &read_bytes(path.as_ref())?)
}

/// [`read_mesh`] from memory; `name` gives the format by its extension and is used in messages.
///
/// # Errors
/// As [`read_mesh`].
pub fn parse_mesh(name: &Path, bytes: &[u8]) -> Result<TriangleMesh, IoError> {
    parse_mesh_with(name, bytes).map(|(mesh, _)| mesh)
}

/// [`read_mesh`] with what the file says of each vertex, if it is the `.ply` of a reconstruction.
///
/// # Errors
/// As [`read_mesh`].
pub fn read_mesh_with(path: impl AsRef<Path>) -> Result<(TriangleMesh, VertexValues), IoError> {
    parse_mesh_with(path.as_ref(), &read_bytes(path.as_ref())?)
}

fn parse_mesh_with(name: &Path, bytes: &[u8]) -> Result<(TriangleMesh, VertexValues), IoError> {
    let raw = parse(name, bytes, ".ply .obj .off .stl")?;
    if let Some((index, p)) = raw.points.iter().enumerate().find(|(_, p)| !is_sane(p)) {
        return Err(IoError::NotFinite { path: name.to_owned(), index, value: [p.x, p.y, p.z] });
    }
    if raw.faces.is_empty() {
        return Err(IoError::NoFaces { path: name.to_owned(), vertices: raw.points.len() });
    }
    Ok((TriangleMesh { vertices: raw.points, faces: raw.faces, colors: raw.colors }, raw.knowledge))
}

/// Reads a point cloud by extension: `.ply`, `.pcd`, or the vertices of a mesh. NaN points are left out silently; use
/// [`read_cloud_file`] to learn how many.
///
/// # Errors
/// [`IoError`] naming the file and what is wrong; a cloud without any finite point is an error.
pub fn read_cloud(path: impl AsRef<Path>) -> Result<PointCloud, IoError> {
    read_cloud_file(path).map(|file| file.cloud)
}

/// [`read_cloud`] with the number of points left out.
///
/// # Errors
/// As [`read_cloud`].
pub fn read_cloud_file(path: impl AsRef<Path>) -> Result<CloudFile, IoError> {
    parse_cloud(path.as_ref(), &read_bytes(path.as_ref())?)
}

/// [`read_cloud_file`] from memory; `name` gives the format by its extension and is used in messages.
///
/// # Errors
/// As [`read_cloud`].
pub fn parse_cloud(name: &Path, bytes: &[u8]) -> Result<CloudFile, IoError> {
    let raw = parse(name, bytes, ".ply .pcd .obj .off .stl")?;
    let total = raw.points.len();
    // A normal of length zero or NaN says "unknown": such points go, unless no point has one.
    let unit = |n: &crate::geometry::Vector| n.try_normalize(1e-12).filter(|n| n.iter().all(|x| x.is_finite()));
    let units: Option<Vec<_>> = raw.normals.map(|n| n.iter().map(unit).collect());
    let units = units.filter(|n| n.iter().any(Option::is_some));
    let keep = |i: usize| is_sane(&raw.points[i]) && units.as_ref().is_none_or(|n| n[i].is_some());
    let kept: Vec<usize> = (0..total).filter(|&i| keep(i)).collect();
    if kept.is_empty() {
        return Err(IoError::content(name, format!("none of its {total} points is finite; at least one is needed")));
    }
    let cloud = PointCloud {
        points: kept.iter().map(|&i| raw.points[i]).collect(),
        normals: units.map(|n| kept.iter().filter_map(|&i| n[i]).collect()),
        colors: raw.colors.map(|c| kept.iter().map(|&i| c[i]).collect()),
    };
    Ok(CloudFile { dropped: total - cloud.len(), cloud })
}

/// Checks that [`write_mesh`] knows the extension.
pub(super) fn check_mesh_extension(path: &Path) -> Result<(), IoError> {
    let known = ".ply .obj .stl .glb";
    if known.split(' ').any(|k| k[1..] == extension(path)) {
        return Ok(());
    }
    Err(IoError::Extension { path: path.to_owned(), known })
}

/// Checks that [`write_cloud`] knows the extension.
pub(super) fn check_cloud_extension(path: &Path) -> Result<(), IoError> {
    if extension(path) == "ply" { Ok(()) } else { Err(IoError::Extension { path: path.to_owned(), known: ".ply" }) }
}

/// Writes a mesh by extension: `.ply` (binary little endian), `.obj`, `.stl` (binary) or `.glb`; vertex colours where the format
/// has them (not STL). Coordinates become 32-bit floats.
///
/// # Errors
/// [`IoError::Extension`], else as [`atomic_write`].
pub fn write_mesh(path: impl AsRef<Path>, mesh: &TriangleMesh) -> Result<(), IoError> {
    write_mesh_with(path, mesh, &[])
}

/// [`write_mesh`] with further values of each vertex. Only `.ply` can hold them; other formats are written without.
///
/// # Errors
/// [`IoError::Content`] if a property has not one value a vertex or a name that a header cannot hold, else as [`write_mesh`].
pub fn write_mesh_with(
    path: impl AsRef<Path>,
    mesh: &TriangleMesh,
    properties: &[VertexProperty],
) -> Result<(), IoError> {
    let path = path.as_ref();
    let plain = |name: &str| !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
    for VertexProperty { name, values } in properties {
        let (found, needed) = (values.len(), mesh.vertices.len());
        if found != needed || !plain(name) {
            let reason = format!("vertex property '{name}' has {found} values; {needed} and a plain name are needed");
            return Err(IoError::content(path, reason));
        }
    }
    match extension(path).as_str() {
        "ply" => atomic_write(path, |w| {
            ply::write(w, &mesh.vertices, None, mesh.colors.as_deref(), Some(&mesh.faces), properties)
        }),
        "obj" => atomic_write(path, |w| obj::write(w, mesh)),
        "stl" => atomic_write(path, |w| stl::write(w, mesh)),
        "glb" => atomic_write(path, |w| glb::write(w, mesh)),
        _ => Err(IoError::Extension { path: path.to_owned(), known: ".ply .obj .stl .glb" }),
    }
}

impl VertexValues {
    /// Whether nothing is said.
    pub fn is_empty(&self) -> bool {
        self.sigma_mm.is_none() && self.provenance.is_none()
    }

    /// As [`write_mesh_with`] takes them.
    pub fn properties(&self) -> Vec<VertexProperty<'_>> {
        let sigma = self.sigma_mm.as_deref().map(PropertyValues::Float);
        let provenance = self.provenance.as_deref().map(PropertyValues::Uchar);
        let named = [("sigma_mm", sigma), ("provenance", provenance)];
        named.into_iter().filter_map(|(name, values)| Some(VertexProperty { name, values: values? })).collect()
    }

    /// The values of the vertices of `after`, each of which is a vertex of `before` that has them; `None` if another is among them.
    pub fn carried(&self, before: &TriangleMesh, after: &TriangleMesh) -> Option<Self> {
        let key = |p: &Point| [p.x, p.y, p.z].map(|c| (c + 0.0).to_bits());
        let at: HashMap<[u64; 3], usize> = before.vertices.iter().enumerate().map(|(i, p)| (key(p), i)).collect();
        let from: Vec<usize> = after.vertices.iter().map(|p| at.get(&key(p)).copied()).collect::<Option<_>>()?;
        Some(Self {
            sigma_mm: self.sigma_mm.as_ref().map(|values| from.iter().map(|&i| values[i]).collect()),
            provenance: self.provenance.as_ref().map(|values| from.iter().map(|&i| values[i]).collect()),
        })
    }
}

/// Writes a cloud as binary little endian PLY with its normals and colours.
///
/// # Errors
/// [`IoError::Extension`] if the name does not end in `.ply`, else as [`atomic_write`].
pub fn write_cloud(path: impl AsRef<Path>, cloud: &PointCloud) -> Result<(), IoError> {
    let path = path.as_ref();
    check_cloud_extension(path)?;
    atomic_write(path, |w| ply::write(w, &cloud.points, cloud.normals.as_deref(), cloud.colors.as_deref(), None, &[]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;

    fn tetrahedron() -> TriangleMesh {
        let points = [[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.125]].map(Point::from).to_vec();
        let mut mesh = TriangleMesh::new(points, vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).expect("valid");
        mesh.colors = Some(vec![[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 20, 30]]);
        mesh
    }

    #[test]
    fn what_is_written_is_read_back() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let mesh = tetrahedron();
        for name in ["m.ply", "m.obj", "m.STL"] {
            let path = folder.path().join(name);
            write_mesh(&path, &mesh).expect("written");
            let back = read_mesh(&path).expect("read");
            assert_eq!(back.volume(), mesh.volume(), "{name}");
            assert_eq!(back.vertices.len(), 4, "{name}");
            if name != "m.STL" {
                assert_eq!(back, mesh, "{name}");
            }
            assert_eq!(read_cloud(&path).expect("vertices").len(), 4, "{name}");
        }
        let error = write_mesh(folder.path().join("m.3ds"), &mesh).expect_err("unknown");
        assert!(error.to_string().contains("must be one of .ply .obj .stl .glb"), "{error}");
    }

    #[test]
    fn further_values_of_vertices_are_written_under_their_names() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("m.ply");
        let mesh = tetrahedron();
        let (sigma, kind) = ([0.5f32, 1.0, 2.0, 4.0], [0u8, 1, 2, 3]);
        let properties = [
            VertexProperty { name: "sigma_mm", values: PropertyValues::Float(&sigma) },
            VertexProperty { name: "provenance", values: PropertyValues::Uchar(&kind) },
        ];
        write_mesh_with(&path, &mesh, &properties).expect("written");
        let (back, values) = read_mesh_with(&path).expect("read");
        assert_eq!(back, mesh);
        assert_eq!(values, VertexValues { sigma_mm: Some(sigma.to_vec()), provenance: Some(kind.to_vec()) });
        assert_eq!(values.properties(), properties);
        let mut part = mesh.clone();
        part.vertices.swap(0, 3);
        part.vertices.truncate(2);
        let carried = values.carried(&mesh, &part).expect("its own vertices");
        assert_eq!(carried, VertexValues { sigma_mm: Some(vec![4.0, 1.0]), provenance: Some(vec![3, 1]) });
        part.vertices[0].x += 1e-6;
        assert_eq!(values.carried(&mesh, &part), None, "a vertex was moved");
        let mut file = std::io::BufReader::new(std::fs::File::open(&path).expect("there"));
        let ply = ply_rs_bw::parser::Parser::<ply_rs_bw::ply::DefaultElement>::new().read_ply(&mut file);
        let vertices = &ply.expect("another reader opens it").payload["vertex"];
        for (i, v) in vertices.iter().enumerate() {
            assert_eq!(v["sigma_mm"], ply_rs_bw::ply::Property::Float(sigma[i]));
            assert_eq!(v["provenance"], ply_rs_bw::ply::Property::UChar(kind[i]));
        }
        for (name, values) in [("sigma_mm", &sigma[..3]), ("two words", &sigma[..]), ("", &sigma[..])] {
            let bad = [VertexProperty { name, values: PropertyValues::Float(values) }];
            let error = write_mesh_with(folder.path().join("bad.ply"), &mesh, &bad).expect_err("refused");
            assert!(error.to_string().contains("vertex property"), "{error}");
        }
        assert!(!folder.path().join("bad.ply").exists());
    }

    #[test]
    fn clouds_keep_normals_and_colours() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("c.ply");
        let mesh = tetrahedron();
        let normals = vec![Vector::x(), Vector::y(), -Vector::z(), Vector::z()];
        let cloud = PointCloud { points: mesh.vertices.clone(), normals: Some(normals), colors: mesh.colors.clone() };
        write_cloud(&path, &cloud).expect("written");
        assert_eq!(read_cloud_file(&path).expect("read"), CloudFile { cloud, dropped: 0 });
        assert!(matches!(read_mesh(&path), Err(IoError::NoFaces { vertices: 4, .. })));
    }

    #[test]
    fn a_mesh_with_nan_is_an_error_and_a_cloud_drops_it() {
        let text = b"v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n";
        let error = parse_mesh(Path::new("bad.obj"), text).expect_err("NaN").to_string();
        assert!(error.contains("bad.obj: vertex 1 is (1, NaN, 0)"), "{error}");
        let file = parse_cloud(Path::new("bad.obj"), text).expect("two are fine");
        assert_eq!((file.cloud.len(), file.dropped), (2, 1));
        assert!(parse_cloud(Path::new("bad.obj"), b"v nan 0 0\n").is_err());
    }
}
