//! Ray bundles: all pairs of surfaces that see each other along one direction, found in one pass (Tokuyoshi et al. 2013).
