"""What the symbol tells: the infinite lattice, speeds."""

from farhorizon.analysis.infinite import infinite_lattice, largest_speed

__all__ = ["infinite_lattice", "largest_speed"]
