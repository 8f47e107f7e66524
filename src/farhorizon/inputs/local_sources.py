"""Sources at points, along lines and on patches, which need not coincide with nodes.

A source at a point is spread over nodes by the weights with which the field at that point is interpolated
(`farhorizon.geometry.interpolation`). The weights add up to one, so that the strength is the same on every lattice, and
source and receiver are reciprocal. Among the nodes over which it is spread, the field is that of the spread source;
beyond them, it is that of the point source.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, OfTime, Registered, Unit
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable
from farhorizon.geometry.interpolation import INTERPOLATIONS, as_points, interpolation_blocks
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.expressions import as_signal
from farhorizon.inputs.sources import Source

_AT_ONCE = 256  # points whose blocks of nodes are held at once
_PER_NODE = 2  # points along a line or a patch for each spacing of its length

_ROUNDING = 1e-15  # of the entries of a unit tensor
_SYMMETRIC = 1e-6  # of the largest entry: tensors in catalogues have six digits and fewer
ANGLES = ("strike", "dip", "rake")


class LocalSource(Registered, Storable, ABC):
    """A source at its own location, which need not coincide with lattice nodes.

    Attributes
    ----------
    tag : str
        Its `type` in a case file: ``PointForce`` is "point-force".
    known : dict of str to type
        All such sources by name, including user-defined ones.
    """

    tag: ClassVar[str]
    known: ClassVar[dict[str, type[LocalSource]]] = {}

    @abstractmethod
    def placed(self, lattice: Lattice, components: int, key: str, cuts: Sequence[Cut] = ()) -> list[Source]:
        """The source on the nodes: an array and its factor of time, for each such factor.

        Parameters
        ----------
        lattice : Lattice
        components : int
            Number of components of the field.
        key : str
            Key that messages name.
        cuts : sequence of Cut
            Cracks, which must not lie between the source and nodes over which it is spread.

        Raises
        ------
        InputError
            A source for another kind of field or another dimension, or one for which some of the nodes over which it is
            spread do not lie in the near field, or lie beyond a crack.
        """


def spread(
    lattice: Lattice,
    points: np.ndarray,
    amounts: np.ndarray,
    interpolation: str,
    key: str,
    derivative: int | None = None,
    moving: int | None = None,
    cuts: Sequence[Cut] = (),
) -> np.ndarray:
    """Return densities on the nodes whose integral is the sum of the `amounts` (n,) at points (n, dim), or their
    changes per length as these move along an axis, `derivative`, and along `moving`, exact for the weights. Raises
    InputError as `farhorizon.geometry.interpolation.interpolation_blocks`.
    """
    density = np.zeros(int(np.prod(lattice.shape)))
    for start in range(0, len(points), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        nodes, weights = interpolation_blocks(
            lattice.whole, points[some], interpolation, derivative, key, moving, cuts
        ).entries()
        inside, here = lattice.own(nodes)
        np.add.at(density, here, (weights * amounts[some, None])[inside])
    return density.reshape(lattice.shape) / lattice.spacing**lattice.dim


def set_source_fields(source: Any, **values: Any) -> None:
    """Check and store what all local sources have, the factor of time and the interpolation, and further values."""
    time = None if source.time is None else as_signal(source.time, "source.time")
    kinds.one_of(source.interpolation, "source.interpolation", INTERPOLATIONS, "unknown interpolation")
    kinds.set_fields(source, time=time, **values)


def place_of(at: Any, key: str = "source.at") -> tuple[float, ...]:
    """Coordinates of one point."""
    coordinates = np.atleast_1d(kinds.array(at, key))
    if coordinates.ndim != 1 or not 1 <= coordinates.size <= 3:
        raise InputError(
            "a point has one coordinate per axis",
            value=kinds.said(at),
            limit="1 to 3 numbers",
            key=key,
            remedy="(x, y) in two dimensions",
        )
    return tuple(coordinates.tolist())


def amount_of(value: Any, key: str) -> float | tuple[float, ...]:
    """A number, or one component per axis."""
    components = kinds.array(value, key)
    if components.ndim > 1 or components.size > 3:
        raise InputError(
            "must be a number, or for an elastic medium one component per axis",
            value=kinds.said(value),
            limit="a number, or up to 3",
            key=key,
            remedy="a number in a scalar field, (fx, fy) in an elastic plane",
        )
    kinds.check_magnitude(components, key)
    return tuple(components.tolist()) if components.ndim else float(components)


def directed(density: np.ndarray, amount: float | tuple[float, ...], components: int, key: str) -> np.ndarray:
    """The density of a scalar field times a number, or of a vector field times a vector."""
    if np.size(amount) != components or (np.ndim(amount) == 0) != (components == 1):
        raise InputError(
            "the source is one of another field",
            value="one number" if np.ndim(amount) == 0 else f"{np.size(amount)} components",
            limit="a number" if components == 1 else f"{components} components",
            key=key,
            remedy="PointSource for a scalar field, PointForce for an elastic medium",
        )
    return np.asarray(amount * density if components == 1 else np.multiply.outer(np.asarray(amount), density))


@dataclass(frozen=True)
class PointSource(LocalSource):
    r"""A source of a scalar field at a point.

    :math:`q\,\delta(x - x_0)\,s(t)` on the right-hand side.

    Parameters
    ----------
    at : sequence of float, or float
        x0, anywhere in the near field; a number in 1D.
    strength : float
        q, the integral of the right-hand side over space.
    time : callable, str, Expression, Signal or float, optional
        Factor of t; 1 unless given.
    interpolation : {"sinc", "linear"}
        How the source is spread over nodes: by a Kaiser-windowed sinc over eight nodes to either side, along each axis
        along which the point lies between nodes, or over the two adjacent nodes.

    Raises
    ------
    InputError
        Coordinates or a strength that are not finite numbers, a factor that is not a function of t; with the lattice: a
        vector field, or a point outside the near field, in a hole, or so close to an edge or a hole that some of the
        nodes over which it is spread are missing.

    Notes
    -----
    Hicks (2002), Geophysics 67(1), 156-165.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0))
    >>> hydrophone = fh.PointSource((0.1, -0.3), time=fh.Ricker(0.3))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sources=[hydrophone])
    >>> round(float(sim.sources[0][0].sum()) * 0.5**2, 12)  # the integral of its density
    1.0
    """

    at: Annotated[Sequence[float] | float, Unit("m")]
    strength: Annotated[float, Unit(ANY)] = 1.0
    time: OfTime = None
    interpolation: str = "sinc"

    def __post_init__(self) -> None:
        set_source_fields(self, at=place_of(self.at), strength=kinds.number(self.strength, "source.strength"))

    def placed(self, lattice: Lattice, components: int, key: str, cuts: Sequence[Cut] = ()) -> list[Source]:
        """The source as arrays on the nodes."""
        density = _at_point(self, lattice, key, cuts=cuts)
        return [Source(directed(density, self.strength, components, f"{key}.strength"), self.time)]

    def moved(self, lattice: Lattice, components: int, key: str, axis: int, cuts: Sequence[Cut] = ()) -> np.ndarray:
        """The change of the source on the nodes per length by which its place moves along an axis."""
        return directed(_at_point(self, lattice, key, axis, cuts), self.strength, components, f"{key}.strength")


@dataclass(frozen=True)
class PointForce(LocalSource):
    r"""A force on an elastic medium at a point.

    :math:`F\,\delta(x - x_0)\,s(t)` per volume.

    Parameters
    ----------
    at : sequence of float
        x0, anywhere in the near field.
    force : sequence of float
        F, one component per axis; in two dimensions, force per length perpendicular to the plane.
    time : callable, str, Expression, Signal or float, optional
        Factor of t; 1 unless given.
    interpolation : {"sinc", "linear"}
        As in `PointSource`.

    Raises
    ------
    InputError
        As in `PointSource`; a medium that is not elastic.

    Notes
    -----
    The displacement of a homogeneous medium is that of Aki and Richards (2002), eq 4.23.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    >>> hammer = fh.PointForce((0.3, 0.0), force=(0.0, -2.0), time=fh.ToneBurst(0.1, 2))
    >>> sim = fh.Simulation(lattice, fh.Elastic(fh.Kernel(2.0), young=1.0), sources=[hammer])
    >>> [round(float(total), 12) + 0.0 for total in sim.sources[0][0].sum(axis=(1, 2))]
    [0.0, -2.0]
    """

    at: Annotated[Sequence[float], Unit("m")]
    force: Annotated[Sequence[float], Unit(ANY)]
    time: OfTime = None
    interpolation: str = "sinc"

    def __post_init__(self) -> None:
        set_source_fields(self, at=place_of(self.at), force=amount_of(self.force, "source.force"))

    def placed(self, lattice: Lattice, components: int, key: str, cuts: Sequence[Cut] = ()) -> list[Source]:
        """The source as arrays on the nodes."""
        density = _at_point(self, lattice, key, cuts=cuts)
        return [Source(directed(density, self.force, components, f"{key}.force"), self.time)]  # type: ignore[arg-type]

    def moved(self, lattice: Lattice, components: int, key: str, axis: int, cuts: Sequence[Cut] = ()) -> np.ndarray:
        """The change of the source on the nodes per length by which its place moves along an axis."""
        density = _at_point(self, lattice, key, axis, cuts)
        return directed(density, self.force, components, f"{key}.force")  # type: ignore[arg-type]


def _at_point(
    source: PointSource | PointForce, lattice: Lattice, key: str, moving: int | None = None, cuts: Sequence[Cut] = ()
) -> np.ndarray:
    points = as_points([source.at], lattice.dim, f"{key}.at")
    return spread(lattice, points, np.ones(1), source.interpolation, f"{key}.at", moving=moving, cuts=cuts)


@dataclass(frozen=True)
class MomentTensor(LocalSource):
    r"""A source without net force at a point: an explosion, a double couple, or any tensor.

    :math:`-M_{ij}\,\partial_j \delta(x - x_0)\,s(t)` per volume.

    Parameters
    ----------
    at : sequence of float
        x0, anywhere in the near field.
    moment : float, or sequence of sequence of float, shape (dim, dim)
        M, force times length, in two dimensions per length perpendicular to the plane. A number denotes an explosion,
        with this multiple of the unit tensor, or, if the three angles are given, a double couple.
    time : callable, str, Expression, Signal or float, optional
        Factor of t; 1 unless given. For an earthquake, whose slip is permanent, use a `Step`.
    strike, dip, rake : float, optional
        Angles of a double couple in three dimensions, in degrees: strike clockwise from north, where x points east, y
        north and z up; dip from the horizontal, down to the right of the strike direction; rake of the slip of the
        upper block, from the strike direction upwards.
    interpolation : {"sinc", "linear"}
        As in `PointSource`; the derivative uses eight nodes to either side, or two, along every axis for which the
        tensor has an entry.

    Raises
    ------
    InputError
        As in `PointForce`; a tensor that is not symmetric; some of the angles without the others, together with a
        tensor, or in other than three dimensions.

    Notes
    -----
    The displacement of a homogeneous medium is that of Aki and Richards (2002), eq 4.29; the tensor of a double couple
    is that of their Box 4.4, in axes with x east and z up. The sum of the forces is zero, and so is the sum of their
    torques, to within the accuracy of the interpolation: no source inside a body rotates it.

    Examples
    --------
    >>> import farhorizon as fh
    >>> quake = fh.MomentTensor((0, 0, 0), 2.0, fh.Step(3.0), strike=0.0, dip=90.0, rake=0.0)
    >>> quake.tensor(3).tolist()  # slip to the north on a vertical plane
    [[0.0, 2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    >>> fh.MomentTensor((0.0, 0.0), 1.0).tensor(2).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """

    at: Annotated[Sequence[float], Unit("m")]
    moment: Annotated[float | Sequence[Sequence[float]], Unit(ANY)]
    time: OfTime = None
    strike: float | None = None
    dip: float | None = None
    rake: float | None = None
    interpolation: str = "sinc"

    def __post_init__(self) -> None:
        moment = kinds.array(self.moment, "source.moment")
        kinds.check_magnitude(moment, "source.moment")
        if moment.shape not in ((), (2, 2), (3, 3)):
            raise InputError(
                "a moment is a number or a tensor",
                value=kinds.said(moment),
                limit="shape (2, 2) in two dimensions, (3, 3) in three",
                key="source.moment",
                remedy="a number for an explosion, or rows of one entry an axis",
            )
        if moment.ndim and np.abs(moment - moment.T).max() > _SYMMETRIC * np.abs(moment).max():
            raise InputError(
                "a moment tensor is symmetric: another exerts a torque, which no source inside a medium does",
                value=moment,
                limit="M = M^T",
                key="source.moment",
                remedy="(M + M^T) / 2; a torque from outside is a pair of PointForce",
            )
        given = {name: getattr(self, name) for name in ANGLES if getattr(self, name) is not None}
        if given and (len(given) < len(ANGLES) or moment.ndim):
            raise InputError(
                "a double couple is given by strike, dip, rake and one number for the moment",
                value=f"{', '.join(given)} and a {'tensor' if moment.ndim else 'number'}",
                limit=f"{', '.join(ANGLES)} and a number",
                key="source.moment",
                remedy="all three angles, or the tensor alone",
            )
        angles = {name: kinds.number(value, f"source.{name}") for name, value in given.items()}
        set_source_fields(self, at=place_of(self.at), moment=moment.tolist(), **angles)

    def tensor(self, dim: int) -> np.ndarray:
        """The moment tensor on a lattice of the given number of dimensions, shape (dim, dim).

        Raises
        ------
        InputError
            A tensor of another shape, a double couple in other than three dimensions.
        """
        if self.strike is not None and dim == 3:
            couple = self._couple()
            # rounding, as in cos(90 degrees), makes no force
            return self.moment * np.where(np.abs(couple) > _ROUNDING, couple, 0.0)
        tensor = np.asarray(self.moment) * np.eye(dim) if np.ndim(self.moment) == 0 else np.asarray(self.moment)
        if self.strike is not None or tensor.shape != (dim, dim):
            raise InputError(
                "the moment tensor is one of another number of dimensions",
                value="strike, dip and rake" if self.strike is not None else f"shape {tensor.shape}",
                limit=f"shape ({dim}, {dim})",
                key="source.moment",
                remedy="a tensor of the lattice's axes",
            )
        return tensor

    def placed(self, lattice: Lattice, components: int, key: str, cuts: Sequence[Cut] = ()) -> list[Source]:
        """The source as arrays on the nodes."""
        if components == 1 or components != lattice.dim:
            raise InputError(
                "a moment tensor acts on an elastic medium",
                value="a scalar field" if components == 1 else f"{components} components",
                limit="Elastic",
                key=key,
                remedy="PointSource for a scalar field",
            )
        return [Source(self._force(lattice, key, cuts=cuts), self.time)]

    def moved(self, lattice: Lattice, components: int, key: str, axis: int, cuts: Sequence[Cut] = ()) -> np.ndarray:
        """The change of the source on the nodes per length by which its place moves along an axis."""
        return self._force(lattice, key, axis, cuts=cuts)

    def turned(self, lattice: Lattice, key: str, angle: str) -> np.ndarray:
        """The change of the source on the nodes per degree of one of the angles of a double couple."""
        step = 1e-20  # of the complex-step derivative: no difference is taken, so nothing cancels
        return self._force(lattice, key, tensor=self.moment * self._couple(**{angle: 1j * step}).imag / step)

    def _couple(self, **more: complex) -> np.ndarray:
        """The double couple of the angles, to each of which some degrees are added."""
        return _double_couple(*(np.pi / 180 * (getattr(self, name) + more.get(name, 0)) for name in ANGLES))

    def _force(
        self,
        lattice: Lattice,
        key: str,
        moving: int | None = None,
        tensor: np.ndarray | None = None,
        cuts: Sequence[Cut] = (),
    ) -> np.ndarray:
        """Its force on the nodes, or the change of that per length along an axis, for its tensor or another one."""
        tensor = self.tensor(lattice.dim) if tensor is None else tensor
        points = as_points([self.at], lattice.dim, f"{key}.at")
        force = np.zeros((lattice.dim, *lattice.shape))
        for axis in np.flatnonzero(tensor.any(0)):
            slope = spread(lattice, points, np.ones(1), self.interpolation, f"{key}.at", int(axis), moving, cuts)
            force += np.multiply.outer(tensor[:, axis], slope)
        return force


def _double_couple(strike: float, dip: float, rake: float) -> np.ndarray:
    """The tensor ``d n + n d`` of unit slip d of the upper block on a plane with the upward normal n, with x east, y
    north and z up; angles in radians.
    """
    along = np.array([np.sin(strike), np.cos(strike), 0.0])
    across = np.array([np.cos(strike), -np.sin(strike), 0.0])  # horizontal, to the right: the direction of dip
    up = np.array([0.0, 0.0, 1.0])
    normal = np.sin(dip) * across + np.cos(dip) * up
    slip = np.cos(rake) * along + np.sin(rake) * (np.sin(dip) * up - np.cos(dip) * across)
    return np.outer(slip, normal) + np.outer(normal, slip)


@dataclass(frozen=True)
class LineSource(LocalSource):
    """A source, or a force on an elastic medium, along a polyline.

    Parameters
    ----------
    points : array_like, shape (n, dim)
        Vertices of the polyline.
    strength : float or sequence of float
        Strength per length; in an elastic medium a force, one component per axis.
    time : callable, str, Expression, Signal or float, optional
        Factor of t; 1 unless given.
    interpolation : {"sinc", "linear"}
        As in `PointSource`.

    Raises
    ------
    InputError
        As in `PointSource`; fewer than two points, or all points coincide.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(0.5, (-9.0, -9.0), (9.0, 9.0))
    >>> wire = fh.LineSource([(-1.0, -2.0), (2.0, 2.0)], strength=3.0, time="sin(t)")  # 5 long
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sources=[wire])
    >>> round(float(sim.sources[0][0].sum()) * 0.5**2, 12)
    15.0
    """

    points: Annotated[Sequence[Sequence[float]], Unit("m")]
    strength: Annotated[float | Sequence[float], Unit(ANY)]
    time: OfTime = None
    interpolation: str = "sinc"

    def __post_init__(self) -> None:
        points = kinds.array(self.points, "source.points", shape=(None, None))
        if len(points) < 2 or not np.ptp(points, axis=0).any():
            raise InputError(
                "a line has two points or more, not all in one place",
                value=kinds.said(points),
                limit="at least 2 different ones",
                key="source.points",
                remedy="PointSource or PointForce at one place",
            )
        set_source_fields(self, points=points.tolist(), strength=amount_of(self.strength, "source.strength"))

    def placed(self, lattice: Lattice, components: int, key: str, cuts: Sequence[Cut] = ()) -> list[Source]:
        """The source as arrays on the nodes."""
        corners = as_points(self.points, lattice.dim, f"{key}.points")
        pieces = [patch(start, [end - start], lattice, f"{key}.points") for start, end in itertools.pairwise(corners)]
        points, amounts = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
        density = spread(lattice, points, amounts, self.interpolation, f"{key}.points", cuts=cuts)
        return [Source(directed(density, self.strength, components, f"{key}.strength"), self.time)]  # type: ignore[arg-type]


def patch(corner: np.ndarray, edges: Sequence[np.ndarray], lattice: Lattice, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Return midpoints of equal parts of a line or a parallelogram, shape (n, dim), and the length or area of each
    part, shape (n,), with at least two parts per spacing; raises InputError for one that is much too long for the
    lattice.
    """
    points, size = corner[None], 1.0
    most = 2 * float(np.linalg.norm(lattice.whole.upper - lattice.whole.lower)) + lattice.spacing
    for edge in edges:
        with np.errstate(over="ignore"):
            length = float(np.linalg.norm(edge))
        if not length <= most:
            raise InputError(
                "reaches beyond the near field",
                value=f"length {length:.4g}",
                limit=f"{shown(lattice.whole.lower)} to {shown(lattice.whole.upper)}",
                key=key,
                remedy="a shorter one, or a larger lattice",
            )
        count = max(1, int(np.ceil(_PER_NODE * length / lattice.spacing)))
        along = (np.arange(count) + 0.5) / count
        points = (points[:, None] + along[None, :, None] * edge).reshape(-1, corner.size)
        size *= length / count
    return points, np.full(len(points), size)
