//! GLB, the binary form of glTF 2.0, out only.
//!
//! Coordinates are the world frame's, as in every other output: no axis is swapped, although a glTF viewer takes y for up.

use crate::geometry::TriangleMesh;
use serde_json::json;
use std::io::{self, Write};

/// Writes one mesh with float positions, `u32` indices and, where given, vertex colours (linear, 16 bit).
pub(super) fn write(w: &mut impl Write, mesh: &TriangleMesh) -> io::Result<()> {
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
    let mut data: Vec<u8> = Vec::new();
    data.extend(positions.iter().flatten().flat_map(|x| x.to_le_bytes()));
    let indices_at = data.len();
    data.extend(mesh.faces.iter().flatten().flat_map(|i| i.to_le_bytes()));
    let colors_at = data.len();
    for rgb in mesh.colors.iter().flatten() {
        let [r, g, b] = rgb.map(linear);
        data.extend([r, g, b, u16::MAX].iter().flat_map(|c| c.to_le_bytes()));
    }
    let bound = |pick: fn(f32, f32) -> f32, start: f32| {
        positions.iter().fold([start; 3], |m, p| [pick(m[0], p[0]), pick(m[1], p[1]), pick(m[2], p[2])])
    };
    // A model without vertices or triangles has no accessors: glTF wants at least one item in each.
    let mut primitive = json!({ "attributes": {}, "mode": 4 });
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let mut accessor = |from: usize, to: usize, target: u32, mut item: serde_json::Value| {
        views.push(json!({ "buffer": 0, "byteOffset": from, "byteLength": to - from, "target": target }));
        item["bufferView"] = json!(views.len() - 1);
        accessors.push(item);
        views.len() - 1
    };
    if !mesh.vertices.is_empty() && !mesh.faces.is_empty() {
        let n = mesh.vertices.len();
        let (low, high) = (bound(f32::min, f32::INFINITY), bound(f32::max, f32::NEG_INFINITY));
        primitive["attributes"]["POSITION"] = json!(accessor(
            0,
            indices_at,
            34962,
            json!({ "componentType": 5126, "count": n, "type": "VEC3", "min": low, "max": high })
        ));
        primitive["indices"] = json!(accessor(
            indices_at,
            colors_at,
            34963,
            json!({ "componentType": 5125, "count": 3 * mesh.faces.len(), "type": "SCALAR" })
        ));
        if mesh.colors.is_some() {
            primitive["attributes"]["COLOR_0"] = json!(accessor(
                colors_at,
                data.len(),
                34962,
                json!({ "componentType": 5123, "normalized": true, "count": n, "type": "VEC4" })
            ));
        }
    }
    let mut document = json!({
        "asset": { "version": "2.0", "generator": concat!("palpate ", env!("CARGO_PKG_VERSION")) },
    });
    if !accessors.is_empty() {
        document["scene"] = json!(0);
        document["scenes"] = json!([{ "nodes": [0] }]);
        document["nodes"] = json!([{ "mesh": 0 }]);
        document["meshes"] = json!([{ "primitives": [primitive] }]);
        document["accessors"] = json!(accessors);
        document["bufferViews"] = json!(views);
        document["buffers"] = json!([{ "byteLength": data.len() }]);
    }
    chunks(w, document.to_string().into_bytes(), data)
}

/// The container: a header of 12 bytes, then the JSON and the binary chunk, each padded to four bytes.
fn chunks(w: &mut impl Write, mut json: Vec<u8>, mut data: Vec<u8>) -> io::Result<()> {
    json.resize(json.len().next_multiple_of(4), b' ');
    data.resize(data.len().next_multiple_of(4), 0);
    let size = |n: usize| u32::try_from(n).map_err(|_| io::Error::other("GLB holds at most 4 GiB"));
    w.write_all(b"glTF")?;
    w.write_all(&2u32.to_le_bytes())?;
    w.write_all(&size(12 + 8 + json.len() + 8 + data.len())?.to_le_bytes())?;
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", data)] {
        w.write_all(&size(chunk.len())?.to_le_bytes())?;
        w.write_all(kind)?;
        w.write_all(&chunk)?;
    }
    Ok(())
}

/// sRGB to linear light, as glTF wants its vertex colours.
fn linear(channel: u8) -> u16 {
    let c = f64::from(channel) / 255.0;
    let light = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    (light * 65535.0).round() as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    #[test]
    fn lengths_bounds_and_colours_are_as_the_format_wants() {
        let points = vec![Point::origin(), Point::new(1.0, 0.0, -2.0), Point::new(0.0, 3.0, 0.0)];
        let mut mesh = TriangleMesh::new(points, vec![[0, 1, 2]]).expect("valid");
        mesh.colors = Some(vec![[0, 128, 255]; 3]);
        let mut bytes = Vec::new();
        write(&mut bytes, &mesh).expect("memory");
        let u32_at = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
        assert_eq!((&bytes[..4], u32_at(4), u32_at(8)), (&b"glTF"[..], 2, bytes.len()));
        let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + u32_at(12)]).expect("JSON");
        assert_eq!(json["accessors"][0]["min"], json!([0.0, 0.0, -2.0]));
        assert_eq!(json["accessors"][0]["max"], json!([1.0, 3.0, 0.0]));
        let data = 20 + u32_at(12) + 8;
        assert_eq!(bytes.len() - data, 36 + 12 + 24);
        // sRGB 128 is 21.6 % of the light.
        assert_eq!(u32_at(data + 48), 14146 << 16);
    }

    #[test]
    fn an_empty_mesh_is_a_valid_document_without_accessors() {
        let mut bytes = Vec::new();
        write(&mut bytes, &TriangleMesh::default()).expect("memory");
        assert!(!String::from_utf8_lossy(&bytes).contains("accessors"));
    }
}
