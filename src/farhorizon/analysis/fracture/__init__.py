"""Cracks: stress intensity factors, the energy that is released, tips and openings, from fields on a lattice."""
