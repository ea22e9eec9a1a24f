//! How many texels a metre each instance gets.
//!
//! A node's `extras.texelsPerMetre` in the file overrides the general number for what hangs on it and below; 0 keeps it out of the light
//! map.

use occlude_scene::{AlphaMode, Pose, Scene};

/// Texels a metre for every instance; `None`: it is not baked. Instances that move by themselves (skins, morphs), shells that let all
/// light pass and unlit materials are not baked.
pub fn densities(scene: &Scene, pose: &Pose, texels_per_metre: f32) -> Vec<Option<f32>> {
    let mut of_node: Vec<f32> = Vec::with_capacity(scene.nodes.len());
    let mut own = scene.texel_densities.iter().peekable();
    for (i, node) in scene.nodes.iter().enumerate() {
        let inherited = node
            .parent
            .map_or(texels_per_metre, |p| of_node[p as usize]);
        of_node.push(
            own.next_if(|o| o.0 as usize == i)
                .map_or(inherited, |o| o.1),
        );
    }
    let of = |posed: &occlude_scene::PosedInstance| {
        let mesh = &scene.meshes[posed.mesh as usize];
        let material = &scene.materials[mesh.material as usize];
        let invisible = material.alpha_mode == AlphaMode::Blend && material.base_color.w <= 0.0;
        let density = of_node[posed.node as usize];
        let bakes = density > 0.0
            && density.is_finite()
            && !material.unlit
            && !invisible
            && posed.deformed.is_none();
        (bakes && !mesh.triangles.is_empty()).then_some(density)
    };
    pose.instances.iter().map(of).collect()
}
