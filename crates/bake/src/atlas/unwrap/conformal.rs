//! Charts by the crate `uvunwrap`.

use super::{Charts, Surface, Unwrap, UnwrapError};
use crate::atlas::Layout;
use glam::{Vec2, Vec3};

/// Leaves segmentation and parameterization to `uvunwrap`: least squares conformal maps, refined as rigidly as possible.
#[derive(Clone, Copy, Debug, Default)]
pub struct Conformal;

impl Unwrap for Conformal {
    fn charts(&self, surface: &Surface) -> Result<Charts, UnwrapError> {
        let positions: &[[f32; 3]] = bytemuck::cast_slice::<Vec3, _>(surface.positions);
        let mesh = uvunwrap::MeshInput::new(positions, surface.triangles.as_flattened());
        let options = uvunwrap::Options {
            // The library's own arrangement is not used: charts are taken apart again.
            packing: uvunwrap::Packing::Fast,
            padding: 0,
            density: uvunwrap::Density::Auto { page_size: 1024 },
            ..uvunwrap::Options::default()
        };
        let atlas = uvunwrap::generate(&[mesh], &options)
            .map_err(|e| UnwrapError::Library(e.to_string()))?;
        let metres = Vec2::new(atlas.width as f32, atlas.height as f32) / atlas.texels_per_unit;
        let flat = &atlas.meshes[0];
        let mut charts = Charts {
            of: Vec::with_capacity(surface.triangles.len()),
            corners: Vec::with_capacity(surface.triangles.len()),
            count: atlas.chart_count,
        };
        for triangle in flat.indices.as_chunks::<3>().0 {
            let vertices = triangle.map(|i| flat.vertices[i as usize]);
            let corners = vertices.map(|v| Vec2::from(v.uv) * metres);
            let area = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]);
            charts.of.push(
                vertices[0]
                    .chart
                    .filter(|_| area > 0.0)
                    .unwrap_or(Layout::NO_CHART),
            );
            charts.corners.push(corners);
        }
        match charts.of.iter().any(|&c| c != Layout::NO_CHART) {
            true => Ok(charts),
            false => Err(UnwrapError::NoArea),
        }
    }
}
