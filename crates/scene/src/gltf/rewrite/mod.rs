//! The source file again, with a UV set of its own for light maps and everything else as it was.
//!
//! The document is edited, not translated: names, extras, extensions, animations, attributes of any kind and order survive. Vertices are
//! split where the new coordinates ask for it, every attribute and morph target with them; their bytes are copied, so quantized data stays
//! quantized. What cannot stay: compression of meshes (Draco, meshopt), strips and fans, triangles that the loader drops, and separate
//! files, which all go into the one GLB.
//!
//! A `TEXCOORD_1` that is there already becomes the next free set, and materials that use it follow.

mod split;
mod unused;

use super::accessor::{Accessor, Component, Shape};
use super::document::Primitive;
use super::source::Source;
use super::{draco, geometry};
use crate::input::Budget;
use crate::write::container;
use crate::{LitNode, Scene, Unfolding, WriteError, WrittenNode};
use serde_json::{Map, Value, json};
pub(crate) use split::split;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write;

type Result<T> = std::result::Result<T, WriteError>;

/// Compression that the output does without.
const UNPACKED: [&str; 3] = [
    "EXT_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_meshopt_compression",
];

/// Key of a view's index in the source while the document is edited.
const OLD: &str = "occlude old view";

pub(crate) fn write(
    scene: &Scene,
    unfoldings: &[Unfolding],
    nodes: &[LitNode],
    out: &mut impl Write,
) -> Result<Vec<WrittenNode>> {
    let mut budget = Budget::new(&scene.path, None);
    let mut source = Source::open(&scene.path, &mut budget)?;
    source.decompress(&mut budget)?;
    let root = source.json()?;
    let mut rewrite = Rewrite {
        scene,
        source: &source,
        unfoldings,
        root,
        binary: Vec::new(),
        bytes: 0,
        primitives: BTreeMap::new(),
        meshes: BTreeMap::new(),
        materials: BTreeMap::new(),
    };
    // Views are renumbered on the way: each remembers where its bytes are.
    for (i, view) in rewrite.list("bufferViews").iter_mut().enumerate() {
        view[OLD] = i.into();
    }
    let written = rewrite.nodes(nodes)?;
    rewrite.images();
    unused::forget_unused(&mut rewrite.root);
    rewrite.gather_views()?;
    let bytes = rewrite.bytes;
    container(&rewrite.root, bytes, &rewrite.binary, out)?;
    Ok(written)
}

/// What becomes of a primitive in one of the meshes that replace a mesh.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Slot {
    /// Another of the meshes shows it.
    Hidden,
    /// It stays as it is.
    Old,
    /// It takes the UVs of an unfolding.
    New(u32),
}

/// A mesh of the file, and what becomes of its primitives.
type MeshKey = (usize, Vec<Slot>);

struct Rewrite<'a> {
    scene: &'a Scene,
    source: &'a Source,
    unfoldings: &'a [Unfolding<'a>],
    root: Value,
    /// New pieces of the binary chunk, each to be padded to 4 bytes.
    binary: Vec<Cow<'a, [u8]>>,
    bytes: u64,
    primitives: BTreeMap<u32, Value>,
    meshes: BTreeMap<MeshKey, u64>,
    /// Materials whose second UV set moved: by index in the file and number of the set.
    materials: BTreeMap<(u32, u32), u64>,
}

impl<'a> Rewrite<'a> {
    fn list(&mut self, key: &str) -> &mut Vec<Value> {
        let list = &mut self.root[key];
        if !list.is_array() {
            *list = json!([]);
        }
        match list {
            Value::Array(list) => list,
            _ => unreachable!("it was just made an array"),
        }
    }

    fn append(&mut self, key: &str, value: Value) -> u64 {
        let list = self.list(key);
        list.push(value);
        list.len() as u64 - 1
    }

    /// New bytes with a view of their own.
    fn view(&mut self, bytes: Vec<u8>, stride: Option<usize>, target: Option<u32>) -> u64 {
        let mut view = json!({"buffer": 0, "byteOffset": self.bytes, "byteLength": bytes.len()});
        if let Some(stride) = stride {
            view["byteStride"] = stride.into();
        }
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.push(Cow::Owned(bytes));
        self.append("bufferViews", view)
    }

    fn push(&mut self, bytes: Cow<'a, [u8]>) {
        self.bytes += (bytes.len() as u64).next_multiple_of(4);
        self.binary.push(bytes);
    }

    /// Hangs meshes on nodes.
    fn nodes(&mut self, nodes: &[LitNode]) -> Result<Vec<WrittenNode>> {
        let mut of_node: BTreeMap<u32, BTreeMap<u32, Vec<usize>>> = BTreeMap::new();
        for (i, lit) in nodes.iter().enumerate() {
            of_node
                .entry(lit.node)
                .or_default()
                .entry(lit.occurrence)
                .or_default()
                .push(i);
        }
        let mut written = vec![WrittenNode::default(); nodes.len()];
        for (node, places) in of_node {
            let file = self
                .scene
                .contents
                .file_nodes
                .get(node as usize)
                .copied()
                .unwrap_or(node) as usize;
            let Some(entry) = self.source.document.nodes.get(file) else {
                continue;
            };
            let Some(mesh) = entry.mesh.map(|m| m as usize) else {
                continue;
            };
            let instances = self.instances(entry);
            let groups = self.groups(mesh, &places, instances.unwrap_or(1), nodes);
            let alone = groups.len() == 1;
            for (number, (key, members)) in groups.into_iter().enumerate() {
                // The first keeps the node, unless each needs instances of its own.
                let target = match alone || (instances.is_none() && number == 0) {
                    true => file,
                    false => self.child(file),
                };
                let shown = self.mesh(&key)?;
                self.list("nodes")[target]["mesh"] = shown.into();
                if instances.is_some() {
                    self.instancing(file, target, &members, nodes, !alone)?;
                }
                for (k, &(_, lit)) in members.iter().enumerate() {
                    let Some(i) = lit else { continue };
                    written[i] = WrittenNode {
                        node: target as u32,
                        instance: instances.map(|_| k as u32),
                    };
                    if instances.is_none() {
                        self.note(target, &nodes[i].extras);
                    }
                }
            }
            if !alone && instances.is_some() {
                let node = &mut self.list("nodes")[file];
                remove(node, "mesh");
                forget_extensions(node, &["EXT_mesh_gpu_instancing"]);
            }
        }
        Ok(written)
    }

    /// The meshes that a node needs, each with the places where it is shown and what is lit there. The first block of a place also shows
    /// what is not lit.
    fn groups(
        &self,
        mesh: usize,
        places: &BTreeMap<u32, Vec<usize>>,
        count: u32,
        nodes: &[LitNode],
    ) -> BTreeMap<MeshKey, Vec<(u32, Option<usize>)>> {
        let primitives = self
            .source
            .document
            .meshes
            .get(mesh)
            .map_or(0, |m| m.primitives.len());
        let mut groups: BTreeMap<MeshKey, Vec<(u32, Option<usize>)>> = BTreeMap::new();
        for place in 0..count {
            let lit = places.get(&place).map_or(&[][..], Vec::as_slice);
            let mut first = vec![Slot::Old; primitives];
            for &u in lit.iter().flat_map(|&i| &nodes[i].unfoldings) {
                if let Some(slot) = first.get_mut(self.origin(u)[1] as usize) {
                    *slot = Slot::Hidden;
                }
            }
            if lit.is_empty() {
                groups.entry((mesh, first)).or_default().push((place, None));
                continue;
            }
            for (k, &i) in lit.iter().enumerate() {
                let mut slots = if k == 0 {
                    first.clone()
                } else {
                    vec![Slot::Hidden; primitives]
                };
                for &u in &nodes[i].unfoldings {
                    if let Some(slot) = slots.get_mut(self.origin(u)[1] as usize) {
                        *slot = Slot::New(u);
                    }
                }
                groups
                    .entry((mesh, slots))
                    .or_default()
                    .push((place, Some(i)));
            }
        }
        groups
    }

    /// How many places `EXT_mesh_gpu_instancing` gives a node; `None` without it.
    fn instances(&self, entry: &super::document::Node) -> Option<u32> {
        let instancing = entry.extensions.instancing.as_ref()?;
        let accessor = instancing.attributes.values().next()?;
        let entry = self.source.document.accessors.get(*accessor as usize)?;
        u32::try_from(entry.count).ok()
    }

    /// The file's mesh and primitive behind an unfolding.
    fn origin(&self, unfolding: u32) -> [u32; 2] {
        let mesh = self.unfoldings[unfolding as usize].mesh;
        self.scene
            .contents
            .file_meshes
            .get(mesh as usize)
            .copied()
            .unwrap_or([u32::MAX; 2])
    }

    fn child(&mut self, parent: usize) -> usize {
        let mut child = json!({});
        let parent_node = &mut self.list("nodes")[parent];
        for key in ["name", "weights", "skin"] {
            if let Some(value) = parent_node.get(key) {
                child[key] = value.clone();
            }
        }
        let child = self.append("nodes", child);
        let node = &mut self.list("nodes")[parent];
        match node.get_mut("children").and_then(Value::as_array_mut) {
            Some(children) => children.push(child.into()),
            None => node["children"] = json!([child]),
        }
        child as usize
    }

    fn note(&mut self, node: usize, extras: &Value) {
        let node = &mut self.list("nodes")[node];
        if !node["extras"].is_object() {
            // Extras may be anything; what is no object is kept beside ours.
            let old = node["extras"].take();
            node["extras"] = if old.is_null() {
                json!({})
            } else {
                json!({"extras": old})
            };
        }
        node["extras"]["lightmap"] = extras.clone();
    }

    /// Instances of `from` at the members' places hang on `to`, with page, scale and offset of each as attributes.
    fn instancing(
        &mut self,
        from: usize,
        to: usize,
        members: &[(u32, Option<usize>)],
        nodes: &[LitNode],
        filter: bool,
    ) -> Result<()> {
        let source = self.source;
        let Some(instancing) = source.document.nodes[from].extensions.instancing.as_ref() else {
            return Ok(());
        };
        let mut attributes = Map::new();
        for (name, &index) in &instancing.attributes {
            let mut accessor = u64::from(index);
            if filter {
                let (bytes, size) = self.elements(index, name)?;
                let of = |place: u32| {
                    bytes
                        .get(place as usize * size..(place as usize + 1) * size)
                        .unwrap_or(&[])
                };
                let kept = members.iter().flat_map(|m| of(m.0)).copied().collect();
                accessor = self.like(index, kept, members.len(), None, false);
            }
            attributes.insert(name.clone(), accessor.into());
        }
        if members.iter().any(|m| m.1.is_some()) {
            let rectangle = |m: &(u32, Option<usize>)| {
                m.1.map_or([-1.0, 0.0, 0.0, 0.0, 0.0], |i| nodes[i].rectangle)
            };
            let bytes = |range: std::ops::Range<usize>| {
                let floats = members
                    .iter()
                    .flat_map(|m| rectangle(m)[range.clone()].to_vec());
                floats.flat_map(f32::to_le_bytes).collect::<Vec<u8>>()
            };
            for (name, kind, bytes) in [
                ("_LIGHTMAP_PAGE", "SCALAR", bytes(0..1)),
                ("_LIGHTMAP_SCALE_OFFSET", "VEC4", bytes(1..5)),
            ] {
                let view = self.view(bytes, None, None);
                let accessor = self.accessor(view, 5126, members.len(), kind);
                attributes.insert(name.into(), accessor.into());
            }
        }
        self.list("nodes")[to]["extensions"]["EXT_mesh_gpu_instancing"] =
            json!({"attributes": attributes});
        Ok(())
    }

    fn accessor(&mut self, view: u64, component: u32, count: usize, kind: &str) -> u64 {
        let accessor =
            json!({"bufferView": view, "componentType": component, "count": count, "type": kind});
        self.append("accessors", accessor)
    }

    /// The mesh of a key: the file's own, or a new one.
    fn mesh(&mut self, key: &MeshKey) -> Result<u64> {
        let (mesh, slots) = key;
        if slots.iter().all(|s| *s == Slot::Old) {
            return Ok(*mesh as u64);
        }
        if let Some(&known) = self.meshes.get(key) {
            return Ok(known);
        }
        let mut json = self.root["meshes"][*mesh].clone();
        let old = json["primitives"].as_array().cloned().unwrap_or_default();
        let mut primitives = Vec::new();
        for (old, slot) in old.into_iter().zip(slots) {
            match slot {
                Slot::Hidden => {}
                Slot::Old => primitives.push(old),
                Slot::New(unfolding) => primitives.push(self.primitive(*unfolding, &old)?),
            }
        }
        json["primitives"] = primitives.into();
        let index = self.append("meshes", json);
        self.meshes.insert(key.clone(), index);
        Ok(index)
    }

    /// A primitive with its new UV set.
    fn primitive(&mut self, unfolding: u32, old: &Value) -> Result<Value> {
        if let Some(known) = self.primitives.get(&unfolding) {
            return Ok(known.clone());
        }
        let source = self.source;
        let [mesh, primitive] = self.origin(unfolding);
        let entry = &source.document.meshes[mesh as usize].primitives[primitive as usize];
        let place = format!("mesh {mesh}, primitive {primitive}");
        let decoded = match &entry.extensions.draco {
            Some(d) => Some(draco::decode(source, entry, d, &place)?),
            None => None,
        };
        let triangles = geometry::kept_triangles(source, entry, decoded.as_ref(), &place)?;
        let wanted = self.scene.meshes[self.unfoldings[unfolding as usize].mesh as usize]
            .triangles
            .len();
        if triangles.len() != wanted {
            return Err(WriteError::Changed {
                path: source.path.clone(),
            });
        }
        let split = split(&triangles, &*self.unfoldings[unfolding as usize].uv);

        let mut json = old.clone();
        let mut attributes = Map::new();
        let moved = entry
            .attributes
            .contains_key("TEXCOORD_1")
            .then(|| free_set(entry));
        for (name, &index) in &entry.attributes {
            let stream = decoded.as_ref().and_then(|d| d.accessor(name));
            let accessor =
                self.gathered(index, stream, name, &split.vertices, name == "POSITION")?;
            let name = match (name.as_str(), moved) {
                ("TEXCOORD_1", Some(set)) => format!("TEXCOORD_{set}"),
                (name, _) => name.to_string(),
            };
            attributes.insert(name, accessor.into());
        }
        let uv: Vec<u8> = bytemuck::cast_slice(&split.uv).to_vec();
        let view = self.view(uv, None, Some(34962));
        let accessor = self.accessor(view, 5126, split.uv.len(), "VEC2");
        attributes.insert("TEXCOORD_1".into(), accessor.into());
        json["attributes"] = attributes.into();
        json["indices"] = self.indices(&split.triangles, split.vertices.len()).into();
        remove(&mut json, "mode");
        if let Some(set) = moved {
            self.move_textures(entry, set, &mut json);
        }
        if !entry.targets.is_empty() {
            let mut targets = Vec::new();
            for target in &entry.targets {
                let mut attributes = Map::new();
                for (name, &index) in target {
                    let accessor =
                        self.gathered(index, None, name, &split.vertices, name == "POSITION")?;
                    attributes.insert(name.clone(), accessor.into());
                }
                targets.push(Value::Object(attributes));
            }
            json["targets"] = targets.into();
        }
        forget_extensions(&mut json, &UNPACKED);
        self.primitives.insert(unfolding, json.clone());
        Ok(json)
    }

    /// Gives the primitive a material that reads its old second UV set under the new number.
    fn move_textures(&mut self, entry: &Primitive, set: u32, json: &mut Value) {
        let Some(material) = entry.material else {
            return;
        };
        let known = self.materials.get(&(material, set)).copied();
        let index = known.unwrap_or_else(|| {
            let mut copy = self.root["materials"][material as usize].clone();
            let index = if renumber_sets(&mut copy, set) {
                self.append("materials", copy)
            } else {
                u64::from(material)
            };
            self.materials.insert((material, set), index);
            index
        });
        json["material"] = index.into();
    }

    fn indices(&mut self, triangles: &[[u32; 3]], vertices: usize) -> u64 {
        // 65535 restarts strips and may not be an index.
        let short = vertices < usize::from(u16::MAX);
        let flat = triangles.as_flattened();
        let bytes = if short {
            flat.iter()
                .flat_map(|&i| (i as u16).to_le_bytes())
                .collect()
        } else {
            bytemuck::cast_slice(flat).to_vec()
        };
        let view = self.view(bytes, None, Some(34963));
        let component = if short { 5123 } else { 5125 };
        self.accessor(view, component, flat.len(), "SCALAR")
    }

    /// All elements of an accessor, tightly packed, and the size of one.
    fn elements(&self, index: u32, place: &str) -> Result<(Vec<u8>, usize)> {
        let accessor = self.source.accessor(index, place, &Shape::ALL)?;
        Ok((accessor.elements(), accessor.size()))
    }

    /// A new accessor of these elements of an old one (or of what a decoder made of it).
    fn gathered(
        &mut self,
        index: u32,
        stream: Option<Accessor>,
        name: &str,
        vertices: &[u32],
        bounds: bool,
    ) -> Result<u64> {
        let (bytes, size, component) = match &stream {
            Some(a) => (
                a.elements(),
                a.size(),
                Some((a.component, a.component.code())),
            ),
            None => {
                let (bytes, size) = self.elements(index, name)?;
                (bytes, size, None)
            }
        };
        // Elements of vertex data begin at multiples of 4 bytes.
        let stride = size.next_multiple_of(4);
        let mut out = vec![0; vertices.len() * stride];
        for (to, &v) in out.chunks_exact_mut(stride.max(1)).zip(vertices) {
            if let Some(from) = bytes.get(v as usize * size..(v as usize + 1) * size) {
                to[..size].copy_from_slice(from);
            }
        }
        let code = self
            .source
            .document
            .accessors
            .get(index as usize)
            .map_or(5126, |a| a.component_type);
        let kind = component
            .map(|c| c.0)
            .or_else(|| Component::from_code(code));
        let limits = kind
            .filter(|_| bounds)
            .map(|kind| limits(&out, stride, size, kind));
        let strided = (stride != size).then_some(stride);
        let accessor = self.like(index, out, vertices.len(), strided, true);
        let list = self.list("accessors");
        let json = &mut list[accessor as usize];
        json["componentType"] = component.map_or(code, |c| c.1).into();
        if component.is_some() {
            remove(json, "normalized");
        }
        if let Some((low, high)) = limits {
            json["min"] = low.into();
            json["max"] = high.into();
        }
        Ok(accessor)
    }

    /// A copy of an accessor with bytes of its own.
    fn like(
        &mut self,
        index: u32,
        bytes: Vec<u8>,
        count: usize,
        stride: Option<usize>,
        vertices: bool,
    ) -> u64 {
        let view = self.view(bytes, stride, vertices.then_some(34962));
        let mut json = self.root["accessors"][index as usize].clone();
        for key in ["sparse", "min", "max", "byteOffset"] {
            remove(&mut json, key);
        }
        json["bufferView"] = view.into();
        json["count"] = count.into();
        self.append("accessors", json)
    }

    /// Pictures from other files go into this one; those that cannot be read keep their names.
    fn images(&mut self) {
        let source = self.source;
        for i in 0..source.document.images.len() {
            let Some(uri) = &source.document.images[i].uri else {
                continue;
            };
            let mut budget = Budget::new(&source.path, None);
            let Ok(bytes) = source.read_uri(uri, "image", &mut budget) else {
                continue;
            };
            let Some(kind) = mime_type(&bytes) else {
                continue;
            };
            let name = uri
                .rsplit(['/', '\\'])
                .next()
                .filter(|_| !uri.starts_with("data:"))
                .map(str::to_string);
            let view = self.view(bytes.into_owned(), None, None);
            let image = &mut self.list("images")[i];
            remove(image, "uri");
            image["bufferView"] = view.into();
            image["mimeType"] = kind.into();
            if let (None, Some(name)) = (image.get("name"), name) {
                image["name"] = name.into();
            }
        }
    }

    /// Brings the bytes of the old views behind the new ones, uncompressed.
    fn gather_views(&mut self) -> Result<()> {
        let source = self.source;
        let mut views = self
            .root
            .get_mut("bufferViews")
            .map(Value::take)
            .unwrap_or_default();
        for view in views.as_array_mut().into_iter().flatten() {
            let Some(old) = view
                .as_object_mut()
                .and_then(|v| v.remove(OLD))
                .and_then(|i| i.as_u64())
            else {
                continue;
            };
            let bytes = source.view(old as u32, "")?.bytes;
            view["buffer"] = 0.into();
            view["byteOffset"] = self.bytes.into();
            view["byteLength"] = bytes.len().into();
            forget_extensions(view, &UNPACKED);
            self.push(Cow::Borrowed(bytes));
        }
        if views.as_array().is_some_and(|v| !v.is_empty()) {
            self.root["bufferViews"] = views;
            self.root["buffers"] = json!([{"byteLength": self.bytes}]);
        } else {
            remove(&mut self.root, "bufferViews");
            remove(&mut self.root, "buffers");
        }
        Ok(())
    }
}

/// The first UV set after the second that the primitive does not use.
fn free_set(entry: &Primitive) -> u32 {
    (2..)
        .find(|set| !entry.attributes.contains_key(&format!("TEXCOORD_{set}")))
        .unwrap_or(2)
}

/// Lets textures of set 1 read another. `false` if there are none.
fn renumber_sets(material: &mut Value, set: u32) -> bool {
    match material {
        Value::Object(map) => {
            let mut found = false;
            for (key, value) in map {
                // Extras are the user's own.
                if key == "texCoord" && value == 1 {
                    *value = set.into();
                    found = true;
                } else if key != "extras" {
                    found |= renumber_sets(value, set);
                }
            }
            found
        }
        Value::Array(list) => list
            .iter_mut()
            .fold(false, |found, v| found | renumber_sets(v, set)),
        _ => false,
    }
}

/// Smallest and largest stored value of each component.
fn limits(
    bytes: &[u8],
    stride: usize,
    size: usize,
    component: Component,
) -> (Vec<Value>, Vec<Value>) {
    let width = component.size();
    let number = |b: &[u8]| match (component, b) {
        (Component::I8, &[a, ..]) => f64::from(a as i8),
        (Component::U8, &[a, ..]) => f64::from(a),
        (Component::I16, &[a, b, ..]) => f64::from(i16::from_le_bytes([a, b])),
        (Component::U16, &[a, b, ..]) => f64::from(u16::from_le_bytes([a, b])),
        (Component::U32, &[a, b, c, d, ..]) => f64::from(u32::from_le_bytes([a, b, c, d])),
        (Component::F32, &[a, b, c, d, ..]) => f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => 0.0,
    };
    let parts = size / width;
    let (mut low, mut high) = (vec![f64::INFINITY; parts], vec![f64::NEG_INFINITY; parts]);
    for element in bytes.chunks_exact(stride) {
        for (k, part) in element[..size].chunks_exact(width).enumerate() {
            low[k] = low[k].min(number(part));
            high[k] = high[k].max(number(part));
        }
    }
    let json = |v: Vec<f64>| v.into_iter().map(Value::from).collect();
    (json(low), json(high))
}

fn mime_type(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("image/png"),
        [0xff, 0xd8, ..] => Some("image/jpeg"),
        [
            b'R',
            b'I',
            b'F',
            b'F',
            _,
            _,
            _,
            _,
            b'W',
            b'E',
            b'B',
            b'P',
            ..,
        ] => Some("image/webp"),
        [0xab, b'K', b'T', b'X', ..] => Some("image/ktx2"),
        _ => None,
    }
}

fn forget_extensions(value: &mut Value, names: &[&str]) {
    if let Some(extensions) = value.get_mut("extensions").and_then(Value::as_object_mut) {
        extensions.retain(|name, _| !names.contains(&name.as_str()));
        if extensions.is_empty() {
            remove(value, "extensions");
        }
    }
}

fn remove(value: &mut Value, key: &str) -> bool {
    value
        .as_object_mut()
        .is_some_and(|map| map.remove(key).is_some())
}
