//! Embree 4, loaded at run time from the path in `$EMBREE4`.
//!
//! Structures and constants are those of Embree's C interface (`rtcore_ray.h`, `rtcore_common.h`, `rtcore_scene.h`).

use libloading::Library;
use occlude_visibility::Ray;
use std::ffi::{CString, c_char, c_void};
use std::sync::atomic::{AtomicIsize, Ordering};

type Handle = *mut c_void;

#[repr(C, align(16))]
struct RtcRay {
    origin: [f32; 3],
    t_near: f32,
    direction: [f32; 3],
    time: f32,
    t_far: f32,
    mask: u32,
    id: u32,
    flags: u32,
}

#[repr(C, align(16))]
struct RtcHit {
    normal: [f32; 3],
    u: f32,
    v: f32,
    primitive: u32,
    geometry: u32,
    instance: u32,
    instance_primitive: u32,
}

#[repr(C, align(16))]
struct RtcRayHit {
    ray: RtcRay,
    hit: RtcHit,
}

/// Rays of a packet.
pub const PACKET: usize = 16;

#[repr(C, align(64))]
struct RtcRay16 {
    origin: [[f32; PACKET]; 3],
    t_near: [f32; PACKET],
    direction: [[f32; PACKET]; 3],
    time: [f32; PACKET],
    t_far: [f32; PACKET],
    mask: [u32; PACKET],
    id: [u32; PACKET],
    flags: [u32; PACKET],
}

#[repr(C, align(64))]
struct Valid([i32; PACKET]);

/// `RTCOccludedArguments`.
#[repr(C, align(16))]
struct Arguments {
    flags: u32,
    feature_mask: u32,
    context: Handle,
    filter: Handle,
    occluded: Handle,
}

const NOTHING: u32 = u32::MAX;
const GEOMETRY_TRIANGLE: u32 = 0;
const BUFFER_INDEX: u32 = 0;
const BUFFER_VERTEX: u32 = 1;
const FORMAT_UINT3: u32 = 0x5003;
const FORMAT_FLOAT3: u32 = 0x9003;
const SCENE_FLAG_ROBUST: u32 = 1 << 2;
const RAY_QUERY_COHERENT: u32 = 1 << 16;
const FEATURES_ALL: u32 = u32::MAX;

/// `RTCBuildQuality`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quality {
    Medium = 1,
    High = 2,
}

/// The library.
#[derive(Clone, Copy)]
pub struct Embree(&'static Library);

/// A built scene. Never freed: the program ends soon.
pub struct EmbreeScene {
    scene: Handle,
    intersect1: unsafe extern "C" fn(Handle, *mut RtcRayHit, *const c_void),
    occluded1: unsafe extern "C" fn(Handle, *mut RtcRay, *const c_void),
    occluded16: unsafe extern "C" fn(*const i32, Handle, *mut RtcRay16, *const Arguments),
    release_scene: unsafe extern "C" fn(Handle),
    release_device: unsafe extern "C" fn(Handle),
    device: Handle,
    /// Bytes that Embree holds, the mesh among them.
    pub bytes: isize,
    /// Processor seconds of the commit, all threads.
    pub build_seconds: f64,
}

// SAFETY: Embree's queries may be called from any thread at once; the handles are only released when the scene is dropped.
unsafe impl Sync for EmbreeScene {}

unsafe extern "C" fn count_memory(counter: Handle, bytes: isize, _post: bool) -> bool {
    // SAFETY: `counter` is the leaked counter that was passed along with this function.
    unsafe { &*counter.cast::<AtomicIsize>() }.fetch_add(bytes, Ordering::Relaxed);
    true
}

impl Embree {
    /// Opens the library that `$EMBREE4` names.
    pub fn open() -> Result<Self, String> {
        let path = std::env::var_os("EMBREE4")
            .filter(|path| !path.is_empty())
            .ok_or("EMBREE4 is not set")?;
        // SAFETY: loading runs the library's initialisers; the user named it as Embree.
        let library =
            unsafe { Library::new(&path) }.map_err(|e| format!("{}: {e}", path.display()))?;
        Ok(Self(Box::leak(Box::new(library))))
    }

    fn function<T: Copy>(self, name: &str) -> T {
        // SAFETY: the callers give the type that Embree's headers declare for this name.
        *unsafe { self.0.get::<T>(name) }.unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Builds a scene from one mesh.
    pub fn build(
        self,
        positions: &[glam::Vec3],
        triangles: &[[u32; 3]],
        quality: Quality,
        robust: bool,
        threads: usize,
    ) -> EmbreeScene {
        let new_device: unsafe extern "C" fn(*const c_char) -> Handle =
            self.function("rtcNewDevice");
        let new_scene: unsafe extern "C" fn(Handle) -> Handle = self.function("rtcNewScene");
        let new_geometry: unsafe extern "C" fn(Handle, u32) -> Handle =
            self.function("rtcNewGeometry");
        let new_buffer: unsafe extern "C" fn(Handle, u32, u32, u32, usize, usize) -> Handle =
            self.function("rtcSetNewGeometryBuffer");
        let set_scene_quality: unsafe extern "C" fn(Handle, u32) =
            self.function("rtcSetSceneBuildQuality");
        let set_scene_flags: unsafe extern "C" fn(Handle, u32) = self.function("rtcSetSceneFlags");
        let set_geometry_quality: unsafe extern "C" fn(Handle, u32) =
            self.function("rtcSetGeometryBuildQuality");
        let commit_geometry: unsafe extern "C" fn(Handle) = self.function("rtcCommitGeometry");
        let release_geometry: unsafe extern "C" fn(Handle) = self.function("rtcReleaseGeometry");
        let attach: unsafe extern "C" fn(Handle, Handle) -> u32 =
            self.function("rtcAttachGeometry");
        let commit_scene: unsafe extern "C" fn(Handle) = self.function("rtcCommitScene");
        let error: unsafe extern "C" fn(Handle) -> i32 = self.function("rtcGetDeviceError");
        let set_monitor: unsafe extern "C" fn(
            Handle,
            unsafe extern "C" fn(Handle, isize, bool) -> bool,
            Handle,
        ) = self.function("rtcSetDeviceMemoryMonitorFunction");
        let config = CString::new(format!("threads={threads}")).expect("no zero byte");
        let memory: &'static AtomicIsize = Box::leak(Box::new(AtomicIsize::new(0)));
        // SAFETY: the calls and their order are those of Embree's manual; buffers are filled within the sizes asked for.
        unsafe {
            let device = new_device(config.as_ptr());
            assert!(!device.is_null(), "Embree makes no device");
            set_monitor(device, count_memory, (&raw const *memory).cast_mut().cast());
            let geometry = new_geometry(device, GEOMETRY_TRIANGLE);
            let vertices = new_buffer(
                geometry,
                BUFFER_VERTEX,
                0,
                FORMAT_FLOAT3,
                12,
                positions.len(),
            );
            std::ptr::copy_nonoverlapping(
                positions.as_ptr().cast::<u8>(),
                vertices.cast(),
                12 * positions.len(),
            );
            let indices = new_buffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, 12, triangles.len());
            std::ptr::copy_nonoverlapping(
                triangles.as_ptr().cast::<u8>(),
                indices.cast(),
                12 * triangles.len(),
            );
            set_geometry_quality(geometry, quality as u32);
            commit_geometry(geometry);
            let scene = new_scene(device);
            set_scene_quality(scene, quality as u32);
            set_scene_flags(scene, if robust { SCENE_FLAG_ROBUST } else { 0 });
            attach(scene, geometry);
            release_geometry(geometry);
            let start = crate::common::process_seconds();
            commit_scene(scene);
            let build_seconds = crate::common::process_seconds() - start;
            assert_eq!(error(device), 0, "Embree reports an error");
            EmbreeScene {
                scene,
                device,
                intersect1: self.function("rtcIntersect1"),
                occluded1: self.function("rtcOccluded1"),
                occluded16: self.function("rtcOccluded16"),
                release_scene: self.function("rtcReleaseScene"),
                release_device: self.function("rtcReleaseDevice"),
                bytes: memory.load(Ordering::Relaxed),
                build_seconds,
            }
        }
    }
}

impl Drop for EmbreeScene {
    fn drop(&mut self) {
        // SAFETY: both were made by `build` and are released once.
        unsafe {
            (self.release_scene)(self.scene);
            (self.release_device)(self.device);
        }
    }
}

#[inline(always)]
fn single(ray: &Ray) -> RtcRay {
    RtcRay {
        origin: ray.origin.to_array(),
        t_near: ray.t_min,
        direction: ray.direction.to_array(),
        time: 0.0,
        t_far: ray.t_max,
        mask: u32::MAX,
        id: 0,
        flags: 0,
    }
}

impl EmbreeScene {
    /// Distances of the nearest hits, infinite without one, by `rtcIntersect1`.
    pub fn closest(&self, rays: &[Ray], out: &mut [f32]) {
        for (ray, out) in rays.iter().zip(out) {
            let mut query = RtcRayHit {
                ray: single(ray),
                hit: RtcHit {
                    normal: [0.0; 3],
                    u: 0.0,
                    v: 0.0,
                    primitive: NOTHING,
                    geometry: NOTHING,
                    instance: NOTHING,
                    instance_primitive: NOTHING,
                },
            };
            // SAFETY: the scene is committed, the query is aligned and filled in; no arguments mean the defaults.
            unsafe { (self.intersect1)(self.scene, &mut query, std::ptr::null()) };
            *out = if query.hit.geometry == NOTHING {
                f32::INFINITY
            } else {
                query.ray.t_far
            };
        }
    }

    /// By `rtcOccluded1`.
    pub fn occluded(&self, rays: &[Ray], out: &mut [bool]) {
        for (ray, out) in rays.iter().zip(out) {
            let mut query = single(ray);
            // SAFETY: as in `closest`.
            unsafe { (self.occluded1)(self.scene, &mut query, std::ptr::null()) };
            *out = query.t_far < 0.0;
        }
    }

    /// By `rtcOccluded16`, marked as coherent.
    pub fn occluded_packets(&self, rays: &[Ray], out: &mut [bool]) {
        let arguments = Arguments {
            flags: RAY_QUERY_COHERENT,
            feature_mask: FEATURES_ALL,
            context: std::ptr::null_mut(),
            filter: std::ptr::null_mut(),
            occluded: std::ptr::null_mut(),
        };
        let mut packet = RtcRay16 {
            origin: [[0.0; PACKET]; 3],
            t_near: [0.0; PACKET],
            direction: [[0.0; PACKET]; 3],
            time: [0.0; PACKET],
            t_far: [0.0; PACKET],
            mask: [u32::MAX; PACKET],
            id: [0; PACKET],
            flags: [0; PACKET],
        };
        let mut valid = Valid([0; PACKET]);
        for (rays, out) in rays.chunks(PACKET).zip(out.chunks_mut(PACKET)) {
            for k in 0..PACKET {
                valid.0[k] = if k < rays.len() { -1 } else { 0 };
                let ray = &rays[k.min(rays.len() - 1)];
                for axis in 0..3 {
                    packet.origin[axis][k] = ray.origin[axis];
                    packet.direction[axis][k] = ray.direction[axis];
                }
                packet.t_near[k] = ray.t_min;
                packet.t_far[k] = ray.t_max;
            }
            // SAFETY: as in `closest`.
            unsafe { (self.occluded16)(valid.0.as_ptr(), self.scene, &mut packet, &arguments) };
            for (k, out) in out.iter_mut().enumerate() {
                *out = packet.t_far[k] < 0.0;
            }
        }
    }
}
