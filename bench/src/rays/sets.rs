//! The ray sets, all made by our own tracer and replayed by every engine.

use super::scene::Soup;
use glam::Vec3;
use occlude_bvh::{Accel, NoFilter};
use occlude_testkit::random::Random;
use occlude_visibility::{Hit, Ray, offset_along_normal};
use std::f32::consts::TAU;

/// What is asked about a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Question {
    Closest,
    Any,
}

/// Rays of one kind.
pub struct Set {
    pub name: &'static str,
    pub question: Question,
    pub rays: Vec<Ray>,
}

/// A point that a ray met.
#[derive(Clone, Copy)]
struct Surface {
    /// Off the surface already.
    position: Vec3,
    normal: Vec3,
}

/// Edge of a tile of coherent rays, pixels.
const TILE: usize = 64;
const LIGHTS: usize = 1024;

fn primary(soup: &Soup, size: usize) -> Vec<Ray> {
    let forward = (soup.target - soup.eye).normalize();
    let up = if forward.y.abs() < 0.99 {
        Vec3::Y
    } else {
        Vec3::X
    };
    let right = forward.cross(up).normalize();
    let up = right.cross(forward);
    let half = (0.5 * soup.yfov).tan();
    let at = |k: usize| (2.0 * (k as f32 + 0.5) / size as f32 - 1.0) * half;
    // Tiles of 8 x 8 pixels inside tiles of 64 x 64, as a renderer goes.
    let mut rays = Vec::with_capacity(size * size);
    for tile in 0..(size / TILE) * (size / TILE) {
        let (tx, ty) = (tile % (size / TILE) * TILE, tile / (size / TILE) * TILE);
        for small in 0..64 {
            let (sx, sy) = (tx + small % 8 * 8, ty + small / 8 * 8);
            for pixel in 0..64 {
                let (x, y) = (sx + pixel % 8, sy + pixel / 8);
                rays.push(Ray::new(
                    soup.eye,
                    (forward + right * at(x) - up * at(y)).normalize(),
                ));
            }
        }
    }
    rays
}

fn surface(soup: &Soup, ray: &Ray, hit: &Hit) -> Surface {
    let [a, b, c] = soup.triangles[hit.primitive as usize].map(|v| soup.positions[v as usize]);
    let normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
    let normal = if normal.dot(ray.direction) > 0.0 {
        -normal
    } else {
        normal
    };
    let position = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
    let extent = a.abs().max(b.abs()).max(c.abs()).max_element();
    Surface {
        position: offset_along_normal(position, normal, extent),
        normal,
    }
}

fn surfaces(soup: &Soup, accel: &Accel, rays: &[Ray]) -> Vec<Surface> {
    let hit = |ray: &Ray| {
        accel
            .closest(ray, &NoFilter)
            .map(|hit| surface(soup, ray, &hit))
    };
    rays.iter().filter_map(hit).collect()
}

fn cosine(normal: Vec3, random: &mut Random) -> Vec3 {
    let (t, b) = normal.any_orthonormal_pair();
    let (u, phi) = (random.unit(), TAU * random.unit());
    (normal * (1.0 - u).sqrt() + t * (u.sqrt() * phi.cos()) + b * (u.sqrt() * phi.sin()))
        .normalize()
}

/// A unit-length shadow ray that ends just before the light.
fn link(from: &Surface, to: &Surface) -> Ray {
    let d = to.position - from.position;
    let length = d.length().max(f32::MIN_POSITIVE);
    Ray {
        origin: from.position,
        t_min: 0.0,
        direction: (d / length).normalize_or(Vec3::Y),
        t_max: length * 0.9999,
    }
}

/// All sets of a scene, `size * size` rays each; `None` if the camera sees nothing.
pub fn make(soup: &Soup, accel: &Accel, size: usize) -> Option<Vec<Set>> {
    let mut random = Random(77);
    let primary = primary(soup, size);
    let seen = surfaces(soup, accel, &primary);
    if seen.is_empty() {
        return None;
    }
    let n = primary.len();
    // Every set has as many rays: the points seen are stretched over the pixels.
    let at = |i: usize| &seen[i * seen.len() / n];
    let bounce: Vec<Ray> = (0..n)
        .map(|i| Ray::new(at(i).position, cosine(at(i).normal, &mut random)))
        .collect();
    let second = surfaces(soup, accel, &bounce);
    let pool = if second.len() >= LIGHTS {
        &second
    } else {
        &seen
    };
    let lights: Vec<Surface> = (0..LIGHTS)
        .map(|_| pool[random.below(pool.len())])
        .collect();
    let facing = |p: &Surface, q: &Surface| {
        let d = q.position - p.position;
        d.dot(p.normal) > 0.0 && d.dot(q.normal) < 0.0
    };
    let shadow: Vec<Ray> = (0..n)
        .map(|i| {
            let mut light = &lights[random.below(LIGHTS)];
            for _ in 0..8 {
                if facing(at(i), light) {
                    break;
                }
                light = &lights[random.below(LIGHTS)];
            }
            link(at(i), light)
        })
        .collect();
    let coherent = (0..n)
        .map(|i| link(at(i), &lights[i / (TILE * TILE) * 37 % LIGHTS]))
        .collect();
    let mut shuffled = shadow.clone();
    for i in (1..n).rev() {
        shuffled.swap(i, random.below(i + 1));
    }
    let set = |name, question, rays| Set {
        name,
        question,
        rays,
    };
    Some(vec![
        set("primary", Question::Closest, primary),
        set("bounce", Question::Closest, bounce),
        set("shadow", Question::Any, shadow),
        set("shuffled", Question::Any, shuffled),
        set("coherent", Question::Any, coherent),
    ])
}
