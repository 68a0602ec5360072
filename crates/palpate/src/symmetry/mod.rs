//! Symmetry as a hypothesis that evidence can reject: planes, axes, spheres.
