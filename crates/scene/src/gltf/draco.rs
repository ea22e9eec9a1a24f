//! `KHR_draco_mesh_compression`, by the pure Rust decoder of `draco-core`.
//!
//! The decoder is foreign code that reads hostile bytes: it gets ceilings from what the document says that it will find,
//! and a panic of its own becomes an error of this file.

use super::accessor::{Accessor, Component, Shape};
use super::document as json;
use super::source::Source;
use crate::SceneError;
use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

const RE_EXPORT: &str = "export the file again, without Draco compression";

/// No compressed primitive has more faces or points.
const MOST: u64 = 1 << 26;

/// A decompressed primitive.
pub(super) struct Decoded {
    pub triangles: Vec<[u32; 3]>,
    streams: BTreeMap<String, Stream>,
}

struct Stream {
    bytes: Vec<u8>,
    component: Component,
    shape: Shape,
}

impl Decoded {
    /// What stands in for the accessor of an attribute; `None`: it was not compressed.
    pub fn accessor(&self, name: &str) -> Option<Accessor<'_>> {
        let stream = self.streams.get(name)?;
        Some(Accessor::decoded(
            &stream.bytes,
            stream.component,
            stream.shape,
        ))
    }
}

/// Decompresses one primitive.
pub(super) fn decode(
    source: &Source,
    primitive: &json::Primitive,
    draco: &json::Draco,
    place: &str,
) -> Result<Decoded, SceneError> {
    let place = format!("{place}, KHR_draco_mesh_compression");
    let fault = |what: &str| source.fault(&place, what, RE_EXPORT);
    let claimed = |accessor: Option<&u32>| {
        let entry = accessor.and_then(|&a| source.document.accessors.get(a as usize));
        entry.map_or(0, |a| a.count).min(MOST)
    };
    let view = source.view(draco.buffer_view, &place)?;
    // Attribute seams may split points beyond what the document counts.
    let faces = claimed(primitive.indices.as_ref()) / 3 + 16;
    let points = 3 * (claimed(primitive.attributes.get("POSITION")) + 16);
    let limits = DecodeLimits::default()
        .with_max_faces(2 * faces)
        .with_max_points(points)
        .with_max_decoded_bytes(points * 64 * draco.attributes.len().clamp(1, 16) as u64);
    let decoded = catch_unwind(AssertUnwindSafe(|| {
        let mut mesh = Mesh::new();
        let mut buffer = DecoderBuffer::new(view.bytes).with_limits(limits);
        MeshDecoder::new()
            .decode(&mut buffer, &mut mesh)
            .map(|()| mesh)
    }));
    let mesh = match decoded {
        Ok(Ok(mesh)) => mesh,
        Ok(Err(e)) => return Err(fault(&format!("cannot be decoded: {e}"))),
        Err(_) => return Err(fault("the Draco decoder gave up on it")),
    };
    let points = mesh.num_points();
    if points as u64 > MOST {
        return Err(fault(&format!("{points} points")));
    }
    let mut streams = BTreeMap::new();
    for (name, &id) in &draco.attributes {
        let Some(attribute) = mesh.attribute_by_unique_id(id) else {
            return Err(fault(&format!("it holds no attribute {id} ({name})")));
        };
        let entry = primitive.attributes.get(name);
        let Some(entry) = entry.and_then(|&a| source.document.accessors.get(a as usize)) else {
            continue;
        };
        let component = Component::from_code(entry.component_type);
        let (Some(component), Some(shape)) = (component, Shape::from_name(&entry.shape)) else {
            return Err(fault(&format!(
                "type {:?} does not fit {name}",
                entry.shape
            )));
        };
        let values = attribute.read_f32s(points, shape.components());
        let stream = match (component, entry.normalized) {
            (Component::U8 | Component::U16 | Component::U32, false) => Stream {
                // Exact: joints and the like are far below 2^24.
                bytes: values
                    .iter()
                    .flat_map(|&v| (v as u32).to_le_bytes())
                    .collect(),
                component: Component::U32,
                shape,
            },
            (_, normalized) => {
                let value = |v: f32| {
                    if normalized {
                        (v / component.one()).max(-1.0)
                    } else {
                        v
                    }
                };
                let bytes = values.iter().flat_map(|&v| value(v).to_le_bytes());
                Stream {
                    bytes: bytes.collect(),
                    component: Component::F32,
                    shape,
                }
            }
        };
        streams.insert(name.clone(), stream);
    }
    let triangles = mesh.faces().iter().map(|f| f.map(|p| p.0)).collect();
    Ok(Decoded { triangles, streams })
}
