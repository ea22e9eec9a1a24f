//! Statistical tests and brute-force oracles that every crate shares.
//!
//! Random results are tested at a stated rate of false alarms. Seeds are fixed, so a test that passes once passes always;
//! the rate says how often a *correct* program would fail after a change of its random numbers. A failure means: look at
//! the evidence, do not try another seed.
//!
//! * [`distribution`]: quantiles and tail probabilities, the Šidák correction for many tests at once;
//! * [`chi2`]: histograms against densities, over the sphere too;
//! * [`estimate`]: means with their uncertainty, Student's and Welch's t-tests;
//! * [`picture`]: the same for every pixel of a picture, and for blocks of pixels;
//! * [`golden`]: pictures to look at when a test fails;
//! * [`oracle`]: rays against triangles by brute force, in double precision;
//! * [`random`]: seeded numbers for test cases.

pub mod chi2;
pub mod distribution;
pub mod estimate;
pub mod golden;
pub mod oracle;
pub mod picture;
pub mod random;
