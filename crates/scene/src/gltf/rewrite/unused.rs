//! Parts of a document that nothing refers to any more.

use super::{UNPACKED, remove};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Extensions whose references to accessors, views and materials are known here. Where a file uses others, nothing is thrown away or
/// renumbered.
const KNOWN: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
];

/// Goes through a document and hands over every reference to one of its lists.
type Walk<'a> = &'a dyn Fn(&mut Value, Visit);

/// Sees references, and may change them.
type Visit<'a> = &'a mut dyn FnMut(&mut Value);

/// Drops accessors, views and meshes that nothing refers to any more, if every reference is known.
pub(super) fn forget_unused(root: &mut Value) {
    for key in ["extensionsUsed", "extensionsRequired"] {
        if let Some(list) = root.get_mut(key).and_then(Value::as_array_mut) {
            list.retain(|name| !UNPACKED.iter().any(|u| name == u));
            if list.is_empty() {
                remove(root, key);
            }
        }
    }
    let known = root["extensionsUsed"].as_array().is_none_or(|used| {
        used.iter().all(|name| {
            name.as_str()
                .is_some_and(|n| KNOWN.contains(&n) || n.starts_with("KHR_materials_"))
        })
    });
    if root["extensionsUsed"].is_null() {
        remove(root, "extensionsUsed");
    }
    if !known {
        return;
    }
    compact(root, "meshes", &|root, visit| {
        each(root, "nodes", &mut |node| reference(node, "mesh", visit));
    });
    compact(root, "accessors", &|root, visit| {
        each(root, "meshes", &mut |mesh| {
            each(mesh, "primitives", &mut |p| {
                reference(p, "indices", visit);
                references(p, "attributes", visit);
                each(p, "targets", &mut |t| all(t, visit));
            });
        });
        each(root, "skins", &mut |s| {
            reference(s, "inverseBindMatrices", visit)
        });
        each(root, "animations", &mut |a| {
            each(a, "samplers", &mut |s| {
                reference(s, "input", visit);
                reference(s, "output", visit);
            });
        });
        each(root, "nodes", &mut |n| {
            if let Some(e) = n
                .get_mut("extensions")
                .and_then(|e| e.get_mut("EXT_mesh_gpu_instancing"))
            {
                references(e, "attributes", visit);
            }
        });
    });
    compact(root, "bufferViews", &|root, visit| {
        each(root, "accessors", &mut |a| {
            reference(a, "bufferView", visit);
            if let Some(sparse) = a.get_mut("sparse") {
                for key in ["indices", "values"] {
                    if let Some(part) = sparse.get_mut(key) {
                        reference(part, "bufferView", visit);
                    }
                }
            }
        });
        each(root, "images", &mut |i| reference(i, "bufferView", visit));
        each(root, "meshes", &mut |mesh| {
            each(mesh, "primitives", &mut |p| {
                if let Some(d) = p
                    .get_mut("extensions")
                    .and_then(|e| e.get_mut("KHR_draco_mesh_compression"))
                {
                    reference(d, "bufferView", visit);
                }
            });
        });
    });
}

/// Removes the entries of a list that `walk` does not come across, and gives the others new numbers.
fn compact(root: &mut Value, key: &str, walk: Walk) {
    let mut used = BTreeSet::new();
    walk(root, &mut |index| {
        used.extend(index.as_u64());
    });
    let count = root[key].as_array().map_or(0, Vec::len) as u64;
    let number: BTreeMap<u64, u64> = used
        .iter()
        .copied()
        .filter(|&i| i < count)
        .zip(0..)
        .collect();
    walk(root, &mut |index| {
        if let Some(new) = index.as_u64().and_then(|i| number.get(&i)) {
            *index = (*new).into();
        }
    });
    if let Some(list) = root.get_mut(key).and_then(Value::as_array_mut) {
        let mut i = 0;
        list.retain(|_| {
            i += 1;
            number.contains_key(&(i - 1))
        });
        if list.is_empty() {
            remove(root, key);
        }
    }
}

fn each(value: &mut Value, key: &str, visit: &mut dyn FnMut(&mut Value)) {
    if let Some(list) = value.get_mut(key).and_then(Value::as_array_mut) {
        list.iter_mut().for_each(visit);
    }
}

fn reference(value: &mut Value, key: &str, visit: &mut dyn FnMut(&mut Value)) {
    if let Some(index) = value.get_mut(key) {
        visit(index);
    }
}

fn references(value: &mut Value, key: &str, visit: &mut dyn FnMut(&mut Value)) {
    if let Some(map) = value.get_mut(key) {
        all(map, visit);
    }
}

fn all(value: &mut Value, visit: &mut dyn FnMut(&mut Value)) {
    if let Some(map) = value.as_object_mut() {
        map.values_mut().for_each(visit);
    }
}
