//! Small scenes of rectangles, and atlases that lay every rectangle out as a square of its own.

use glam::{Affine3A, Vec2, Vec3};
use occlude_bake::atlas::{Atlas, Layout, Page, Placement};
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
        let mut x = 1;
        let placements: Vec<Option<Placement>> = self
            .texels
            .iter()
            .map(|texels| {
                let [width, height] = (*texels)?;
                let offset = Vec2::new(x as f32, 1.0);
                x += width + 1;
                Some(Placement {
                    page: 0,
                    scale: Vec2::new(width as f32, height as f32),
                    offset,
                })
            })
            .collect();
        let height = self.texels.iter().flatten().map(|t| t[1]).max();
        Atlas {
            pages: vec![Page {
                width: x,
                height: height.unwrap_or(0) + 2,
                first_texel: 0,
            }],
            layouts: vec![
                Layout {
                    corners: vec![
                        [Vec2::ZERO, Vec2::X, Vec2::ONE],
                        [Vec2::ZERO, Vec2::ONE, Vec2::Y],
                    ],
                };
                self.scene.meshes.len()
            ],
            placements,
        }
    }
}

/// The texels of an instance: number and place in the unit square of its middle.
pub fn texels(atlas: &Atlas, instance: usize) -> Vec<(u32, Vec2)> {
    let Some(placement) = atlas.placements[instance] else {
        return Vec::new();
    };
    let page = atlas.pages[placement.page as usize];
    let (width, height) = (placement.scale.x as u32, placement.scale.y as u32);
    let all = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    all.map(|(x, y)| {
        let texel = page.texel(x + placement.offset.x as u32, y + placement.offset.y as u32);
        let place = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / placement.scale;
        (texel, place)
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
