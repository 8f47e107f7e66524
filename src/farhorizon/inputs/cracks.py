"""Cracks: bonds that are cut or weakened, at the start or at a given time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Duration, OneOf, Points
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut, DiscCut, PointCut, PolygonCut, Polyline, Rectangle

#: Keys of a case file that give a cut.
CUT_KEYS = {
    "points": Annotated[Points, "Points of a polyline (2D), corners of a polygon (3D), or a position (1D)."],
    "rectangle": Annotated[Rectangle, "Rectangle in 3D: one corner and the two edges from it."],
    "disc": Annotated[DiscCut, "Disc in 3D: centre, normal and radius."],
}


@dataclass(frozen=True)
class Crack(Storable):
    """A cut that weakens the bonds across it instead of removing them, or that opens later.

    Parameters
    ----------
    cut : Cut, sequence of points (2D, 3D) or position (1D)
    factor : float
        Remaining fraction of the bonds that it crosses: 0 insulates, 1 has no effect.
    opens : float
        Time at which it opens; it takes effect in the first step that begins at or after this time.

    Raises
    ------
    InputError
        A factor outside 0..1, a time that is not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> weak = fh.Crack([(-3.0, 0.5), (3.0, 0.5)], factor=0.2)  # bonds across it keep a fifth
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), cracks=[weak])
    >>> sim.engine.absent.count > 0
    True
    """

    cut: Annotated[Any, OneOf(**CUT_KEYS)]
    factor: float = 0.0
    opens: Duration = 0.0

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            factor=kinds.number(self.factor, "crack.factor", least=0, most=1),
            opens=kinds.number(self.opens, "crack.opens"),
        )
        if not isinstance(self.cut, Cut):
            kinds.array(self.cut, "crack")


def as_crack(crack: Any, dim: int) -> Crack:
    """A crack as a `Crack` whose cut is a `Cut`; errors as of `as_cut`."""
    if isinstance(crack, Crack):
        return Crack(as_cut(crack.cut, dim), crack.factor, crack.opens)
    return Crack(as_cut(crack, dim))


def as_cut(crack: Any, dim: int) -> Cut:
    """Return a crack as a `Cut`: itself, a position (1D), points of a polyline (2D), or the corners of a polygon (3D);
    raises InputError for one of another dimension than the lattice, and points where a surface is needed (3D).
    """
    if isinstance(crack, Cut):
        cut = crack
    elif dim == 1:
        cut = PointCut(kinds.array(np.ravel(kinds.array(crack, "crack")), "crack", shape=(1,))[0])
    elif dim == 2:
        cut = Polyline(crack)
    elif (points := kinds.array(crack, "crack")).ndim == 2 and len(points) >= 3:
        cut = PolygonCut(points)
    else:
        raise InputError(
            "a crack in 3D is a surface",
            value=crack,
            key="crack",
            remedy="use Rectangle(...), DiscCut(...) or the corners of a polygon",
        )
    if cut.dim != dim:
        raise InputError("crack and lattice differ in dimension", value=cut.dim, limit=dim, key="crack")
    return cut


def cut_bonds(
    cut: Cut, lower: np.ndarray, spacing: float, shape: tuple[int, ...], offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bonds of a lattice, with its first node at `lower`, that a crack cuts, in both directions: indices of
    their first nodes (n, dim), and numbers of their offsets (n,).
    """
    reach = np.abs(offsets).max(0)
    low, high = (np.asarray(b, float) for b in cut.bounds())
    first = np.maximum(np.floor((low - lower) / spacing).astype(int) - reach - 1, 0)
    last = np.minimum(np.ceil((high - lower) / spacing).astype(int) + reach + 1, np.array(shape) - 1)
    if (last < first).any():
        return np.zeros((0, len(shape)), int), np.zeros(0, int)
    grid = np.stack(
        np.meshgrid(*[np.arange(a, b + 1) for a, b in zip(first, last, strict=True)], indexing="ij"), -1
    ).reshape(-1, len(shape))
    start = lower + spacing * grid
    nodes, bonds = [], []
    for number, offset in enumerate(offsets):
        hit = cut.cuts(start, start + spacing * offset)
        nodes.append(grid[hit])
        bonds.append(np.full(int(hit.sum()), number))
    return np.concatenate(nodes), np.concatenate(bonds)


def cut_ends(cut: Cut, lattice: Lattice, offsets: np.ndarray) -> np.ndarray:
    """Indices of both ends of the bonds that a crack cuts, also of ends beyond the lattice; shape (n, dim)."""
    nodes, bonds = cut_bonds(cut, lattice.lower, lattice.spacing, lattice.shape, offsets)
    return np.concatenate([nodes, nodes + offsets[bonds]])
