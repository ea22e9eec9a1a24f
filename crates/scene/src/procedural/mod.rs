//! Scenes made by program: nothing to download, any size, the same bytes on every machine.
//!
//! All of them come with cameras and light. Solid things are closed, their fronts face outwards, walls have thickness,
//! and no two faces coincide. Randomness comes from an own generator, sines from an own series: the standard library's
//! differ between platforms.

mod apartment;
mod boxes;
mod builder;
mod city;
mod conference;
mod courtyard;
mod furniture;
mod hairball;
mod many_lights;
mod math;
mod moving;
mod shape;

use crate::Scene;
use builder::Builder;
use std::fmt;
use std::str::FromStr;

/// The procedural scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Name {
    /// The classic box, in metres.
    Cornell,
    /// A closed room with radiance 1 everywhere.
    Furnace,
    /// Six rooms, furniture, 24 lamps, a sun, sky through windows.
    Apartment,
    /// A meeting room under emissive panels.
    Conference,
    /// A ball of thin strands.
    Hairball,
    /// Buildings around a yard of instanced foliage.
    Courtyard,
    /// Kilometres of town, wildly uneven in detail.
    City,
    /// A hall with ten thousand lights.
    ManyLights,
    /// A hat that deforms on moving cloth.
    HatOnCloth,
    /// Two balls that roll in a dish.
    BallsInDish,
    /// A man with a hat who walks.
    WalkingHat,
}

impl Name {
    /// All of them.
    pub const ALL: &[Self] = &[
        Self::Cornell,
        Self::Furnace,
        Self::Apartment,
        Self::Conference,
        Self::Hairball,
        Self::Courtyard,
        Self::City,
        Self::ManyLights,
        Self::HatOnCloth,
        Self::BallsInDish,
        Self::WalkingHat,
    ];

    /// As on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cornell => "cornell",
            Self::Furnace => "furnace",
            Self::Apartment => "apartment",
            Self::Conference => "conference",
            Self::Hairball => "hairball",
            Self::Courtyard => "courtyard",
            Self::City => "city",
            Self::ManyLights => "many-lights",
            Self::HatOnCloth => "hat-on-cloth",
            Self::BallsInDish => "balls-in-dish",
            Self::WalkingHat => "walking-hat",
        }
    }

    /// What it shows, for help texts.
    pub fn about(self) -> &'static str {
        match self {
            Self::Cornell => "the classic box: two blocks, one area light",
            Self::Furnace => "a closed room with radiance 1 in every pixel",
            Self::Apartment => "six furnished rooms, 24 lamps, a sun, sky through windows",
            Self::Conference => "a meeting room under emissive panels",
            Self::Hairball => "a ball of thin curved strands",
            Self::Courtyard => "a yard of instanced foliage: ten million triangles seen flat",
            Self::City => "4.9 km of town, from blocks to millimetres",
            Self::ManyLights => "a store house with 10,000 lights",
            Self::HatOnCloth => "a hat deforms on cloth in the wind, for 4 s",
            Self::BallsInDish => "two balls roll in a dish, for 5 s",
            Self::WalkingHat => "a man with a hat walks, for 4 s",
        }
    }

    fn make(self, detail: f32, seed: u64) -> Builder {
        match self {
            Self::Cornell => boxes::cornell(detail),
            Self::Furnace => boxes::furnace(detail),
            Self::Apartment => apartment::apartment(detail, seed),
            Self::Conference => conference::conference(detail, seed),
            Self::Hairball => hairball::hairball(detail, seed),
            Self::Courtyard => courtyard::courtyard(detail, seed),
            Self::City => city::city(detail, seed),
            Self::ManyLights => many_lights::many_lights(detail, seed),
            Self::HatOnCloth => moving::hat_on_cloth(detail, seed),
            Self::BallsInDish => moving::balls_in_dish(detail, seed),
            Self::WalkingHat => moving::walking_hat(detail, seed),
        }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// There is no procedural scene of that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no procedural scene is called {0:?}")]
pub struct UnknownName(pub String);

impl FromStr for Name {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let known = Self::ALL.iter().find(|name| name.as_str() == text);
        known.copied().ok_or_else(|| UnknownName(text.into()))
    }
}

/// Builds a scene. `triangles` asks for about that many (every instance counted) instead of the scene's own number;
/// things keep their place and size and become finer or coarser, or more or fewer where there are many.
pub fn build(name: Name, triangles: Option<u64>, seed: u64) -> Scene {
    let mut built = name.make(1.0, seed);
    if let Some(wanted) = triangles {
        let mut detail = 1.0;
        // Counts are nearly proportional to detail; a few steps correct what rounding and fixed parts spoil.
        for _ in 0..6 {
            let ratio = wanted.max(1) as f32 / built.triangles().max(1) as f32;
            if (0.95..1.05).contains(&ratio) {
                break;
            }
            detail *= ratio;
            built = name.make(detail, seed);
        }
    }
    built.scene
}
