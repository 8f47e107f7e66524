"""Cracks: stress intensity factors, energy release rates, tips and openings, from fields on a lattice."""
