"""Where: regions, cuts, the nodes of the lattice."""
