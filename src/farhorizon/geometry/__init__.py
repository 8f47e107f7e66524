"""Regions of space, cuts, the lattice, and its decomposition for several processes."""
