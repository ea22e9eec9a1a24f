//! Small scenes of rectangles, and atlases that lay every rectangle out as a square of its own.

#![allow(dead_code)] // Every test binary uses a part of it.

use glam::{Affine3A, UVec2, Vec2, Vec3};
use occlude_bake::atlas::{Atlas, Layout, Page, Placement, Rectangle};
use occlude_scene::{Instance, Material, Mesh, Node, Scene};

/// A scene of rectangles, each an instance of its own, and the texels of each.
#[derive(Default)]
pub struct Build {
    pub scene: Scene,
    pub texels: Vec<Option<[u32; 2]>>,
}

impl Build {
    /// A rectangle around `center` with half sides `a` and `b`; its front is on the side of `a x b`. `texels` along `a` and `b`.
    pub fn rectangle(
        &mut self,
        center: Vec3,
        a: Vec3,
        b: Vec3,
        texels: Option<[u32; 2]>,
        material: Material,
    ) {
        let scene = &mut self.scene;
        let index = scene.meshes.len() as u32;
        scene.materials.push(material);
        scene.nodes.push(Node {
            name: String::new(),
            parent: None,
            parent_from_node: Affine3A::IDENTITY,
        });
        scene.meshes.push(Mesh {
            positions: vec![
                center - a - b,
                center + a - b,
                center + a + b,
                center - a + b,
            ],
            uv0: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material: index,
            ..Mesh::default()
        });
        scene.instances.push(Instance {
            mesh: index,
            node: index,
            node_from_object: Affine3A::IDENTITY,
            skin: None,
        });
        self.texels.push(texels);
    }

    /// The six walls of the box between two corners, fronts inwards: -x, +x, -y, +y, -z, +z.
    pub fn room(&mut self, low: Vec3, high: Vec3, texels: [[u32; 2]; 6], material: &Material) {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        for axis in 0..3 {
            let [u, v] = [Vec3::AXES[(axis + 1) % 3], Vec3::AXES[(axis + 2) % 3]];
            for (side, sign) in [(0, -1.0), (1, 1.0)] {
                let place = center + Vec3::AXES[axis] * half * sign;
                let (a, b) = (u * half, v * half);
                let (a, b) = if sign > 0.0 { (b, a) } else { (a, b) };
                self.rectangle(place, a, b, Some(texels[2 * axis + side]), material.clone());
            }
        }
    }

    /// All squares side by side on one page, with a texel between them.
    pub fn atlas(&self) -> Atlas {
        let mut atlas = Atlas::default();
        let mut x = 1;
        for (instance, texels) in self.texels.iter().enumerate() {
            let mut layout = Layout::default();
            let [width, height] = texels.unwrap_or_default();
            let at = |x: u32, y: u32| Vec2::new(x as f32, y as f32);
            let corners = [at(0, 0), at(width, 0), at(width, height), at(0, height)];
            layout.mesh = instance as u32;
            layout.corners = vec![
                [corners[0], corners[1], corners[2]],
                [corners[0], corners[2], corners[3]],
            ];
            layout.charts = vec![0; 2];
            layout.pieces = vec![UVec2::new(width, height)];
            atlas.layouts.push(layout);
            atlas.rectangles.push(Rectangle {
                page: 0,
                offset: UVec2::new(x, 1),
                block: 0,
            });
            atlas.placements.push(texels.map(|_| Placement {
                layout: instance as u32,
                first_rectangle: instance as u32,
            }));
            x += width + 1;
        }
        let height = self.texels.iter().flatten().map(|t| t[1]).max();
        atlas.pages.push(Page {
            width: x,
            height: height.unwrap_or(0) + 2,
            first_texel: 0,
        });
        atlas
    }
}

/// The texels of an instance: number and place in the unit square of its middle.
pub fn texels(atlas: &Atlas, instance: usize) -> Vec<(u32, Vec2)> {
    if atlas.placements[instance].is_none() {
        return Vec::new();
    }
    let size = atlas.layouts[instance].pieces[0];
    let offset = atlas.rectangles[instance].offset;
    let all = (0..size.y).flat_map(|y| (0..size.x).map(move |x| UVec2::new(x, y)));
    all.map(|at| {
        let texel = atlas.pages[0].texel(at.x + offset.x, at.y + offset.y);
        (texel, (at.as_vec2() + 0.5) / size.as_vec2())
    })
    .collect()
}

/// A Lambert surface.
pub fn matt(color: f32) -> Material {
    Material {
        base_color: Vec3::splat(color).extend(1.0),
        metallic: 0.0,
        specular: 0.0,
        ..Material::default()
    }
}
