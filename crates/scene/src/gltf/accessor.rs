//! Typed arrays out of buffers.
//!
//! [`Source::accessor`] checks everything once (ranges, overflow, sparse indices) before anything is allocated, so that
//! reading cannot fail and never allocates more than the file holds, up to the widening of small integers.

use super::source::Source;
use crate::SceneError;

const RE_EXPORT: &str = "export the file again";

/// How one number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    pub fn from_code(code: u32) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    /// The stored value that means 1 in a normalised array.
    pub fn one(self) -> f32 {
        match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32767.0,
            Self::U16 => 65535.0,
            Self::U32 => 4_294_967_295.0,
            Self::F32 => 1.0,
        }
    }

    /// The number that stands for it in a file.
    pub fn code(self) -> u32 {
        match self {
            Self::I8 => 5120,
            Self::U8 => 5121,
            Self::I16 => 5122,
            Self::U16 => 5123,
            Self::U32 => 5125,
            Self::F32 => 5126,
        }
    }

    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }
}

/// What an array holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    Mat2,
    Mat3,
    Mat4,
}

impl Shape {
    pub const ALL: [Self; 7] = [
        Self::Scalar,
        Self::Vec2,
        Self::Vec3,
        Self::Vec4,
        Self::Mat2,
        Self::Mat3,
        Self::Mat4,
    ];

    pub fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "SCALAR" => Self::Scalar,
            "VEC2" => Self::Vec2,
            "VEC3" => Self::Vec3,
            "VEC4" => Self::Vec4,
            "MAT2" => Self::Mat2,
            "MAT3" => Self::Mat3,
            "MAT4" => Self::Mat4,
            _ => return None,
        })
    }

    pub fn components(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Vec2 => 2,
            Self::Vec3 => 3,
            Self::Vec4 | Self::Mat2 => 4,
            Self::Mat3 => 9,
            Self::Mat4 => 16,
        }
    }
}

/// A checked accessor: every element is known to lie in its buffer.
#[derive(Clone, Debug)]
pub(super) struct Accessor<'a> {
    /// Number of elements.
    pub count: usize,
    pub component: Component,
    pub shape: Shape,
    normalized: bool,
    /// First element, distance of elements; `None`: all zero.
    base: Option<(&'a [u8], usize)>,
    /// Replaced elements and their tightly packed values.
    sparse: Option<(Vec<u32>, &'a [u8])>,
}

impl Source {
    /// Looks up an accessor and checks that all of it can be read.
    pub fn accessor(
        &self,
        index: u32,
        place: &str,
        shapes: &[Shape],
    ) -> Result<Accessor<'_>, SceneError> {
        let Some(entry) = self.document.accessors.get(index as usize) else {
            let what = format!("refers to accessor {index}, which does not exist");
            return Err(self.fault(place, &what, RE_EXPORT));
        };
        let place = format!("{place}, accessor {index}");
        let fault = |what: &str| Err(self.fault(&place, what, RE_EXPORT));
        let Some(component) = Component::from_code(entry.component_type) else {
            return fault(&format!(
                "component type {} is unknown",
                entry.component_type
            ));
        };
        let Some(shape) = Shape::from_name(&entry.shape).filter(|s| shapes.contains(s)) else {
            return fault(&format!("type {:?} does not fit here", entry.shape));
        };
        let size = element_size(component, shape);
        let base = match entry.buffer_view {
            Some(view) => {
                let view = self.view(view, &place)?;
                let stride = view.stride.unwrap_or(size);
                let past = elements_end(entry.byte_offset, entry.count, stride, size);
                if past.is_none_or(|end| end > view.bytes.len() as u64) {
                    let what = format!(
                        "{} elements of {size} bytes do not fit in {} bytes",
                        entry.count,
                        view.bytes.len()
                    );
                    return fault(&what);
                }
                if stride < size && entry.count > 1 {
                    return fault(&format!(
                        "byte stride {stride} is below the element size {size}"
                    ));
                }
                let start = (entry.byte_offset as usize).min(view.bytes.len());
                Some((&view.bytes[start..], stride))
            }
            // Zeros cost the file nothing, so the claim is held against what the file does hold.
            None if entry.count > self.total_bytes() => {
                return fault(&format!("{} elements without data", entry.count));
            }
            None => None,
        };
        let sparse = match &entry.sparse {
            None => None,
            Some(sparse) => {
                if sparse.count > entry.count {
                    return fault("more sparse elements than elements");
                }
                let values = self.packed(
                    sparse.values.buffer_view,
                    sparse.values.byte_offset,
                    sparse.count,
                    size,
                    &place,
                )?;
                let width = match sparse.indices.component_type {
                    5121 => 1,
                    5123 => 2,
                    5125 => 4,
                    other => return fault(&format!("sparse index type {other} is unknown")),
                };
                let indices = self.packed(
                    sparse.indices.buffer_view,
                    sparse.indices.byte_offset,
                    sparse.count,
                    width,
                    &place,
                )?;
                let indices: Vec<u32> = indices
                    .chunks_exact(width)
                    .map(|b| {
                        b.iter()
                            .rev()
                            .fold(0, |word, &byte| word << 8 | u32::from(byte))
                    })
                    .collect();
                if let Some(bad) = indices.iter().find(|&&i| u64::from(i) >= entry.count) {
                    return fault(&format!("sparse index {bad} is out of range"));
                }
                Some((indices, values))
            }
        };
        Ok(Accessor {
            count: entry.count as usize,
            component,
            shape,
            normalized: entry.normalized,
            base,
            sparse,
        })
    }

    fn packed(
        &self,
        view: u32,
        offset: u64,
        count: u64,
        size: usize,
        place: &str,
    ) -> Result<&[u8], SceneError> {
        let view = self.view(view, place)?;
        match elements_end(offset, count, size, size).filter(|&e| e <= view.bytes.len() as u64) {
            Some(end) => Ok(&view.bytes[offset as usize..end as usize]),
            None => {
                let what = format!("{count} sparse elements do not fit in their buffer view");
                Err(self.fault(place, &what, RE_EXPORT))
            }
        }
    }
}

fn element_size(component: Component, shape: Shape) -> usize {
    let columns = match shape {
        Shape::Mat2 => 2,
        Shape::Mat3 => 3,
        Shape::Mat4 => 4,
        _ => return component.size() * shape.components(),
    };
    columns * (component.size() * columns).next_multiple_of(4)
}

/// One past the last byte of strided elements; `None` on overflow.
fn elements_end(offset: u64, count: u64, stride: usize, size: usize) -> Option<u64> {
    match count {
        0 => Some(offset),
        _ => (count - 1)
            .checked_mul(stride as u64)?
            .checked_add(size as u64)?
            .checked_add(offset),
    }
}

impl<'a> Accessor<'a> {
    /// An accessor of tightly packed elements that a decoder has made: floats, or integers of 32 bits.
    pub fn decoded(bytes: &'a [u8], component: Component, shape: Shape) -> Self {
        let size = component.size() * shape.components();
        Self {
            count: bytes.len() / size,
            component,
            shape,
            normalized: false,
            base: Some((bytes, size)),
            sparse: None,
        }
    }

    /// Elements as floats; normalised integers become fractions, others keep their value. `N` is at most the number of
    /// components an element has.
    pub fn floats<const N: usize, T: Clone>(&self, map: impl Fn([f32; N]) -> T) -> Vec<T> {
        match (self.component, self.normalized) {
            (Component::F32, _) => self.gather(f32::from_le_bytes, map),
            (Component::I8, true) => self.gather(|[b]| (f32::from(b as i8) / 127.0).max(-1.0), map),
            (Component::I8, false) => self.gather(|[b]| f32::from(b as i8), map),
            (Component::U8, true) => self.gather(|[b]| f32::from(b) / 255.0, map),
            (Component::U8, false) => self.gather(|[b]| f32::from(b), map),
            (Component::I16, true) => self.gather(
                |b| (f32::from(i16::from_le_bytes(b)) / 32767.0).max(-1.0),
                map,
            ),
            (Component::I16, false) => self.gather(|b| f32::from(i16::from_le_bytes(b)), map),
            (Component::U16, true) => {
                self.gather(|b| f32::from(u16::from_le_bytes(b)) / 65535.0, map)
            }
            (Component::U16, false) => self.gather(|b| f32::from(u16::from_le_bytes(b)), map),
            (Component::U32, true) => self.gather(
                |b| (f64::from(u32::from_le_bytes(b)) / 4_294_967_295.0) as f32,
                map,
            ),
            (Component::U32, false) => self.gather(|b| u32::from_le_bytes(b) as f32, map),
        }
    }

    /// Elements as unsigned integers; `None` if they are stored as something else.
    pub fn integers<const N: usize, T: Clone>(
        &self,
        map: impl Fn([u32; N]) -> T,
    ) -> Option<Vec<T>> {
        Some(match self.component {
            Component::U8 => self.gather(|[b]| u32::from(b), map),
            Component::U16 => self.gather(|b| u32::from(u16::from_le_bytes(b)), map),
            Component::U32 => self.gather(u32::from_le_bytes, map),
            _ => return None,
        })
    }

    /// Bytes of an element. Columns of matrices of small integers are padded to 4 bytes (glTF 2.0, section 3.6.2.4).
    pub fn size(&self) -> usize {
        element_size(self.component, self.shape)
    }

    /// The bytes of all elements, tightly packed.
    pub fn elements(&self) -> Vec<u8> {
        let size = self.size();
        let mut out = vec![0; size * self.count];
        if let Some((bytes, stride)) = self.base {
            // The last element may end before its stride does.
            for (to, from) in out.chunks_exact_mut(size).zip(bytes.chunks(stride)) {
                to.copy_from_slice(&from[..size]);
            }
        }
        if let Some((indices, values)) = &self.sparse {
            for (&i, from) in indices.iter().zip(values.chunks_exact(size)) {
                out[i as usize * size..][..size].copy_from_slice(from);
            }
        }
        out
    }

    fn gather<const N: usize, const B: usize, C: Copy + Default, T: Clone>(
        &self,
        decode: impl Fn([u8; B]) -> C,
        map: impl Fn([C; N]) -> T,
    ) -> Vec<T> {
        let element = |bytes: &[u8]| {
            let (parts, _) = bytes.as_chunks::<B>();
            let mut value = [C::default(); N];
            for (to, from) in value.iter_mut().zip(parts) {
                *to = decode(*from);
            }
            map(value)
        };
        let size = self.component.size() * self.shape.components();
        let mut out = match self.base {
            Some((bytes, stride)) if stride == N * B => bytes
                .chunks_exact(N * B)
                .take(self.count)
                .map(element)
                .collect(),
            // The last element may end before its stride does.
            Some((bytes, stride)) => bytes.chunks(stride).take(self.count).map(element).collect(),
            None => vec![map([C::default(); N]); self.count],
        };
        if let Some((indices, values)) = &self.sparse {
            for (&i, bytes) in indices.iter().zip(values.chunks_exact(size)) {
                if let Some(slot) = out.get_mut(i as usize) {
                    *slot = element(bytes);
                }
            }
        }
        out
    }
}
