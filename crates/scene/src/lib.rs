//! Scenes: an immutable description of a world, and where everything in it is at one time.
//!
//! * [`Scene`] is what a file says: meshes, instances, materials, textures, lights, cameras and animation;
//! * [`Pose`] is where everything is at one time: world transforms and deformed vertices. The scene itself never changes.
//!
//! World space is metres, right-handed, +Y up; colours are linear Rec. 709; angles are radians.

mod camera;
mod error;
mod facts;
mod fingerprint;
mod gltf;
mod image_file;
mod input;
mod light;
mod material;
mod mesh;
mod motion;
mod moves;
mod obj;
mod pose;
mod prefetch;
pub mod procedural;
mod scene;
mod texture;
mod validate;
mod write;

pub use camera::{Camera, Projection};
pub use error::{SceneError, Warning};
pub use fingerprint::fingerprint;
pub use light::{Light, LightKind};
pub use material::{AlphaMode, Material, NormalMap, TextureRef, Volume};
pub use mesh::{Mesh, MorphTarget, Skinning};
pub use motion::{Channel, Clip, Interpolation, Motion, RestTransform, RestWeights, Target};
pub use moves::moving_instances;
pub use pose::{Deformed, Pose, PosedInstance, PosedLight};
pub use prefetch::prefetch;
pub use scene::{Contents, Instance, Node, Scene, Skin};
pub use texture::{Filter, Image, Sampler, Texels, Texture, Wrap};
pub use write::{LitNode, Unfolding, WriteError, WrittenNode, write_glb, write_lit_glb};
