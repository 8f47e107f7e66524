"""What the symbol tells: the infinite lattice, speeds."""

from farhorizon.analysis.infinite import InfiniteLattice, largest_speed, undisturbed

__all__ = ["InfiniteLattice", "largest_speed", "undisturbed"]
