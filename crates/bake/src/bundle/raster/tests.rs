//! The rasterizer against rays, and its instruction sets against each other.

use super::*;
use crate::atlas::Atlas;
use crate::bundle::Directions;
use crate::bundle::bins::Bins;
use crate::bundle::fragments::{LinkedList, Peel, ScanScatter, sort};
use crate::bundle::tile::{Place, Tile, Tiling};
use glam::{Affine3A, Vec3};
use occlude_scene::{Instance, Material, Mesh, Node, Pose, Scene};
use occlude_testkit::random::Random;

/// A scene of one mesh.
fn scene(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Scene {
    Scene {
        nodes: vec![Node {
            name: String::new(),
            parent: None,
            parent_from_node: Affine3A::IDENTITY,
        }],
        materials: vec![Material::default()],
        meshes: vec![Mesh {
            positions,
            triangles,
            ..Mesh::default()
        }],
        instances: vec![Instance {
            mesh: 0,
            node: 0,
            node_from_object: Affine3A::IDENTITY,
            skin: None,
        }],
        ..Scene::default()
    }
}

/// A closed ball with many thin triangles at its poles.
fn ball() -> Scene {
    let (columns, rows) = (37_u32, 29_u32);
    let mut positions = Vec::new();
    for row in 0..=rows {
        for column in 0..columns {
            let theta = std::f32::consts::PI * row as f32 / rows as f32;
            let phi = std::f32::consts::TAU * column as f32 / columns as f32;
            // The poles are one point each, to the bit.
            let r = if row % rows == 0 { 0.0 } else { theta.sin() };
            positions.push(Vec3::new(r * phi.cos(), theta.cos(), r * phi.sin()) * 3.0);
        }
    }
    let mut triangles = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let at = |r: u32, c: u32| r * columns + c % columns;
            let (a, b) = (at(row, column), at(row, column + 1));
            let (c, d) = (at(row + 1, column), at(row + 1, column + 1));
            triangles.push([a, b, d]);
            triangles.push([a, d, c]);
        }
    }
    scene(positions, triangles)
}

/// All triangles on one tile of `lines` lines.
struct Fixture<'a> {
    triangles: Triangles<'a>,
    frame: Frame,
    tiling: Tiling,
    bins: Bins,
    key: u32,
}

impl<'a> Fixture<'a> {
    fn new(scene: &'a Scene, pose: &'a Pose, index: u32, lines: u32) -> Self {
        let triangles = Triangles::new(scene, pose, &Atlas::default());
        let direction = Directions { seed: 3, round: 0 }.direction(index);
        let frame = Frame::new(&direction, &triangles, 256);
        let mut tiling = Tiling::default();
        tiling.tiles.push(Tile {
            x: 0.0,
            y: 0.0,
            width: 256.0,
            lines,
        });
        let tiling = tiling.rooted(Place::Tile(0), 256.0);
        let mut bins = Bins::default();
        bins.cut(&tiling, direction.key);
        assert!(bins.fill(Isa::Plain, &triangles, &frame, &tiling, 0..1, usize::MAX));
        Self {
            triangles,
            frame,
            tiling,
            bins,
            key: direction.key,
        }
    }

    /// The sorted fragments of every line of a bin that has some.
    fn lines(&self, isa: Isa, number: u32, mut fragments: impl Fragments) -> Vec<Vec<Fragment>> {
        let bin = &self.bins.bins[number as usize];
        fragments.begin((bin.width * bin.height) as usize);
        let source = Source {
            triangles: &self.triangles,
            frame: &self.frame,
            grid: &self.bins.cuts[bin.tile as usize].grid,
            bin,
            key: self.key,
        };
        let clip = Clip {
            x: [0, bin.width],
            y: [0, bin.height],
        };
        let target = Target {
            origin: 0,
            pitch: bin.width as usize,
        };
        for list in self.bins.lists(number) {
            let mut scratch = Scratch::default();
            rasterize(
                isa,
                &source,
                list,
                clip,
                target,
                &mut scratch,
                &mut fragments,
            );
        }
        assert_eq!(fragments.dropped(), 0);
        let mut out = Vec::new();
        fragments.lists(|list| {
            sort(list);
            out.push(list.to_vec());
        });
        out
    }

    fn all(&self, isa: Isa) -> Vec<Vec<Fragment>> {
        let bins = 0..self.bins.bins.len() as u32;
        bins.flat_map(|bin| self.lines(isa, bin, ScanScatter::new(1 << 20)))
            .collect()
    }
}

#[test]
fn a_closed_surface_is_met_once_on_the_way_in_and_once_on_the_way_out() {
    let scene = ball();
    let pose = Pose::at(&scene, 0.0);
    for index in 0..40 {
        let fixture = Fixture::new(&scene, &pose, index, 500);
        let lines = fixture.all(Isa::detect());
        assert!(lines.len() > 60_000, "{}", lines.len());
        for line in lines {
            let sides: Vec<bool> = line
                .iter()
                .map(|&f| crate::bundle::fragments::front(f).1)
                .collect();
            // Fronts are outwards: the first looks back along the line, the second along it.
            assert!(
                sides == [false, true],
                "direction {index}: {sides:?} {line:x?}"
            );
        }
    }
}

#[test]
fn a_tiling_of_the_plane_is_covered_once() {
    // Random triangles of a plane: all edges are shared.
    let n = 40;
    let mut random = Random(7);
    let mut positions = Vec::new();
    for y in 0..=n {
        for x in 0..=n {
            let inner = x > 0 && y > 0 && x < n && y < n;
            let shake = |r: &mut Random| if inner { (r.unit() - 0.5) * 0.4 } else { 0.0 };
            let (dx, dy) = (shake(&mut random), shake(&mut random));
            positions.push(Vec3::new(x as f32 + dx, y as f32 + dy, 0.0));
        }
    }
    let mut triangles = Vec::new();
    for y in 0..n {
        for x in 0..n {
            let at = |x: u32, y: u32| y * (n + 1) + x;
            triangles.push([at(x, y), at(x + 1, y), at(x + 1, y + 1)]);
            triangles.push([at(x, y), at(x + 1, y + 1), at(x, y + 1)]);
        }
    }
    let scene = scene(positions, triangles);
    let pose = Pose::at(&scene, 0.0);
    for index in 0..20 {
        let fixture = Fixture::new(&scene, &pose, index, 300);
        assert!(
            fixture
                .all(Isa::detect())
                .iter()
                .all(|line| line.len() == 1)
        );
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let mut random = Random(5);
    let mut unit = || random.unit();
    let mut positions = Vec::new();
    for k in 0..1500 {
        let size = if k % 10 == 0 { 20.0 } else { 0.5 };
        let middle = Vec3::new(unit(), unit(), unit()) * 10.0;
        for _ in 0..3 {
            positions.push(middle + (Vec3::new(unit(), unit(), unit()) - 0.5) * size);
        }
    }
    positions[7] = Vec3::splat(f32::NAN);
    positions[11] = positions[10];
    let triangles = (0..1500).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    let scene = scene(positions, triangles);
    let pose = Pose::at(&scene, 0.0);
    for index in 0..5 {
        let fixture = Fixture::new(&scene, &pose, index, 200);
        let plain = fixture.all(Isa::Plain);
        assert!(plain.iter().map(Vec::len).sum::<usize>() > 40_000);
        for isa in Isa::all() {
            assert!(fixture.all(isa) == plain, "{isa:?}");
        }
        for bin in 0..fixture.bins.bins.len() as u32 {
            let scattered = fixture.lines(Isa::detect(), bin, ScanScatter::new(1 << 20));
            let linked = fixture.lines(Isa::detect(), bin, LinkedList::new(1 << 20));
            assert!(scattered == linked, "layouts");
        }
        assert_eq!(fixture.tiling.tiles.len(), 1);
    }
}

#[test]
fn a_line_comes_in_depth_ranges() {
    let mut peel = Peel::new(3);
    let all: Vec<Fragment> = [5, 1, 9, 9, 9, 9, 2, 7, 7, 3, 0].to_vec();
    let mut got = Vec::new();
    loop {
        peel.begin(1);
        for &fragment in &all {
            peel.put(0, &[fragment; SPAN], 1);
        }
        peel.lists(|list| {
            assert!(list.len() <= 3);
            got.extend_from_slice(list);
        });
        if !peel.more() {
            break;
        }
    }
    let mut sorted = all;
    sorted.sort_unstable();
    assert_eq!(got, sorted);
}
