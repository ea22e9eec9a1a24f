//! The binary chunk: pieces of vertex data and pictures, and the views and accessors that describe them.

use bytemuck::Pod;
use glam::Vec3;
use serde_json::{Value, json};
use std::borrow::Cow;

// glTF is little-endian; the scene's arrays are written as they are in memory.
const _: () = assert!(cfg!(target_endian = "little"));

/// What a buffer view is for: glTF's `target`.
pub(super) enum Use {
    Vertices,
    Indices,
    /// Animation, skin and instance data.
    Other,
}

/// Pieces in file order; each is padded to 4 bytes when written.
#[derive(Default)]
pub(super) struct Buffers<'a> {
    chunks: Vec<Cow<'a, [u8]>>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    /// Bytes so far, padding included.
    pub length: u64,
}

impl<'a> Buffers<'a> {
    /// Adds bytes; returns the index of their buffer view.
    pub fn view(&mut self, bytes: Cow<'a, [u8]>, used_for: Use) -> usize {
        let mut view = json!({"buffer": 0, "byteOffset": self.length, "byteLength": bytes.len()});
        match used_for {
            Use::Vertices => view["target"] = 34962.into(),
            Use::Indices => view["target"] = 34963.into(),
            Use::Other => {}
        }
        self.length += (bytes.len() as u64).next_multiple_of(4);
        self.chunks.push(bytes);
        self.views.push(view);
        self.views.len() - 1
    }

    /// Adds one element of `kind` (glTF's name) for each item; returns the index of the accessor.
    pub fn array<T: Pod>(
        &mut self,
        data: Cow<'a, [T]>,
        component: u32,
        kind: &str,
        used_for: Use,
    ) -> usize {
        let count = data.len();
        let view = self.view(raw(data), used_for);
        self.accessor(view, component, count, kind)
    }

    /// Adds triangles, `component` wide.
    pub fn triangles<T: Pod>(&mut self, data: Cow<'a, [[T; 3]]>, component: u32) -> usize
    where
        [T; 3]: Pod,
    {
        let count = 3 * data.len();
        let view = self.view(raw(data), Use::Indices);
        self.accessor(view, component, count, "SCALAR")
    }

    /// Adds numbers, `width` of them an element of `kind`.
    pub fn floats(&mut self, data: Vec<f32>, kind: &str, width: usize) -> usize {
        let count = data.len() / width;
        let view = self.view(raw(Cow::Owned(data)), Use::Other);
        self.accessor(view, FLOAT, count, kind)
    }

    /// Adds times of keys: their bounds are part of the accessor.
    pub fn times(&mut self, data: &[f32]) -> usize {
        let accessor = self.floats(data.to_vec(), "SCALAR", 1);
        let first = data.iter().copied().fold(f32::INFINITY, f32::min);
        let last = data.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        self.accessors[accessor]["min"] = super::vector(&[first]);
        self.accessors[accessor]["max"] = super::vector(&[last]);
        accessor
    }

    fn accessor(&mut self, view: usize, component: u32, count: usize, kind: &str) -> usize {
        self.accessors.push(
            json!({"bufferView": view, "componentType": component, "count": count, "type": kind}),
        );
        self.accessors.len() - 1
    }

    /// Adds positions or displacements: their bounds are part of the accessor.
    pub fn positions(&mut self, data: &'a [Vec3]) -> usize {
        let accessor = self.array(Cow::Borrowed(data), FLOAT, "VEC3", Use::Vertices);
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &p in data {
            low = low.min(p);
            high = high.max(p);
        }
        self.accessors[accessor]["min"] = super::vector(&low.to_array());
        self.accessors[accessor]["max"] = super::vector(&high.to_array());
        accessor
    }

    /// Views, accessors and chunks.
    pub fn finish(self) -> (Vec<Value>, Vec<Value>, Vec<Cow<'a, [u8]>>) {
        (self.views, self.accessors, self.chunks)
    }
}

pub(super) const UNSIGNED_SHORT: u32 = 5123;
pub(super) const UNSIGNED_INT: u32 = 5125;
pub(super) const FLOAT: u32 = 5126;

fn raw<T: Pod>(data: Cow<'_, [T]>) -> Cow<'_, [u8]> {
    match data {
        Cow::Borrowed(data) => Cow::Borrowed(bytemuck::cast_slice(data)),
        Cow::Owned(data) => Cow::Owned(bytemuck::cast_slice(&data).to_vec()),
    }
}
