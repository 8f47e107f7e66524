"""Dirichlet-type condition from plane waves: halo values are fitted to outgoing modes, from a cloud of nearby nodes at
the last steps.

Shojaei, Hermann, Seleson and Cyron (2020) for diffusion, Hermann, Shojaei, Seleson, Cyron and Silling (2023) for waves.
`update_matrix` needs only nodes, normals and the medium, so that it can close any cloud of points, a finite-element
mesh as well as a lattice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from scipy import sparse
from scipy.spatial import ConvexHull, QhullError, cKDTree

from farhorizon import kinds
from farhorizon.analysis import modes
from farhorizon.arguments import Length, Unit
from farhorizon.boundaries.outline import Closing, Medium, OutlineNodes
from farhorizon.errors import InputError

_CHOICES = {
    "fit": ("operator", "collocation"),
    "dispersion": ("discrete", "continuum", "taylor", "local"),
    "time": ("discrete", "continuous"),
    "normals": ("lattice", "free"),
}
# Hermann et al. (2023), section 4.3 and remark 1: condition numbers of at most 1e11 to 1e12, and weights of at most 2
_CONDITION, _NORM = 1e12, 2.0
_MOST = 1000  # most modes along a direction, directions, and nodes of a cloud's grid: far beyond use, and soon computed


@dataclass(frozen=True)
class Recipe:
    """Complete options of a `PlaneWave`; angles in radians, `wavenumbers` is the array of all of them."""

    operator: bool
    dispersion: str
    discrete: bool
    radius: float
    cone: float
    thin: int
    snapped: bool
    angle: float
    angles: int
    balanced: bool
    wavenumbers: np.ndarray
    regularization: float | None
    rcond: float


@dataclass(frozen=True)
class PlaneWave(Closing):
    """Side or outline at which the halo follows outgoing modes, fitted to the nodes of a cloud.

    The condition is local in space and time: it is accurate to the extent that the far field near a node is a sum of
    its modes, about 1e-3 for waves. Its stability is not proven; `check` computes it for every set-up. Options left out
    take, for waves, an operator fit whose regularisation keeps it stable in damped media; for diffusion the published
    collocation with wavenumbers on the scale of the near field. `check --tune` searches for sharper settings.

    In elastic media in the plane the modes are the P and S waves of the lattice: eigenvectors of the matrix symbol. The
    fit is regularised more strongly, for it grows otherwise, and is accurate to about 1e-2.

    Parameters
    ----------
    fit : {"operator", "collocation"}, optional
        Fit the acceleration at the centre, with the largest weight on long waves, or the next value as published.
    dispersion : {"discrete", "continuum", "taylor", "local"}, optional
        The dispersion relation of the modes: that of the lattice, of the kernel, of its first correction, or of the
        classical equation.
    time : {"discrete", "continuous"}, optional
        Factor of a mode per step: that of the scheme, or the exponential.
    layer : float, optional
        Thickness of the fringe of fitted nodes; as far as the stencil reaches unless given. Beyond a thinner fringe
        bonds are absent.
    radius : float, optional
        Radius of a cloud. Waves: the reach of the stencil, at least two spacings; in elastic media two. One spacing for
        diffusion and for wide stencils for waves in 1D, one and a half among points without a lattice: wider clouds
        lead to growth there.
    cone : float, optional
        Half the opening angle of a cloud about the inward normal, in degrees: 45 for waves, 180 (a complete ball) for
        diffusion.
    thin : int, optional
        Use only the nodes nearest to a grid of `thin` spacings along normal and tangents. Collocation of waves: chosen
        such that three remain along the normal.
    normals : {"lattice", "free"}, optional
        Rotate clouds to the nearest direction between lattice nodes (multiples of 45 degrees), which makes all clouds
        of one direction identical and symmetric, or leave them as they are. "lattice" for waves on a lattice, otherwise
        "free".
    angle : float, optional
        Largest angle between modes and normal, in degrees: 30 (operator fit; in elastic media 15), otherwise 45.
    angles : int
        Number of directions from -angle to angle; in 3D rings about the normal.
    wavenumber : float, optional
        Largest wavenumber: 1 (in elastic media 1.5) divided by the spacing for the operator fit, 1/4 for other waves;
        diffusion: 6 divided by half the extent of the nodes, at most 1/10 divided by the spacing.
    wavenumbers : int, optional
        Number of wavenumbers, evenly spaced starting at `smallest`: 10 for the operator fit, otherwise 5.
    smallest : float, optional
        Smallest wavenumber; a fortieth of the largest for the operator fit, otherwise the interval between wavenumbers.
    regularization : float, optional
        Tikhonov regularisation parameter; collocation uses the pseudo-inverse unless it is given. The operator fit uses
        1, the order of its unknowns: they are fitted as far as the modes determine them; in elastic media 3. Below 1e-4
        it merely suppresses rounding errors: the fit reflects a fifth as much, and grows in most set-ups.
    rcond : float
        Singular values below this fraction of the largest are cut off by the pseudo-inverse. 1e-12 unless given: the
        condition number of what is inverted then stays within the range that Hermann et al. (2023), remark 1,
        recommend.
    balanced : bool
        False: the published grid of directions in 3D, which favours one side.

    Raises
    ------
    InputError
        Unknown options, numbers out of range.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.PlaneWave(), {"u": "exp(-(x**2 + y**2)/4)"})
    >>> sim.step(10)
    >>> bool(abs(sim.fields["u"]).max() < 1)
    True
    """

    fit: str | None = None
    dispersion: str | None = None
    time: str | None = None
    layer: Length | None = None
    radius: Length | None = None
    cone: float | None = None
    thin: int | None = None
    normals: str | None = None
    angle: float | None = None
    angles: int = 11
    wavenumber: Annotated[float | None, Unit("1/m")] = None
    wavenumbers: int | None = None
    smallest: Annotated[float | None, Unit("1/m")] = None
    regularization: float | None = None
    rcond: float = 1 / _CONDITION
    balanced: bool = True

    assumes = Closing.assumes - {"one component"}

    def __post_init__(self) -> None:
        takes: dict[str, Callable[[Any, str], Any]] = {
            name: partial(kinds.one_of, known=known, message="unknown choice") for name, known in _CHOICES.items()
        }
        takes |= dict.fromkeys(("layer", "radius", "cone", "wavenumber", "smallest"), partial(kinds.number, above=0))
        takes |= dict.fromkeys(("thin", "wavenumbers"), partial(kinds.integer, least=1, most=_MOST))
        takes |= {"angle": partial(kinds.number, least=0, below=90), "regularization": partial(kinds.number, least=0)}
        given = {name: take for name, take in takes.items() if getattr(self, name) is not None}
        given |= {
            "angles": partial(kinds.integer, least=1, most=_MOST),
            "rcond": partial(kinds.number, least=0, below=1),
            "balanced": kinds.flag,
        }
        kinds.set_fields(self, **{name: take(getattr(self, name), f"boundary.{name}") for name, take in given.items()})

    def calmer(self) -> str:
        """Return the default, or damping where it is the default that grows: it is certified in damped media."""
        return "a model with damping=0.15 / crossing time" if self == PlaneWave() else "PlaneWave() without options"

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the outline: much less than the error
        of the condition itself.
        """
        return 1e-6

    def recipe(self, medium: Medium, spacing: float, extent: float) -> Recipe:
        """Return all options, with defaults for those left out, for a medium on nodes `spacing` apart over 2
        `extent`.
        """
        waves, lattice = medium.order == 2, len(medium.weights) > 0
        operator = (self.fit or ("operator" if waves else "collocation")) == "operator"
        reach = float(np.abs(medium.offsets).max(initial=0.0))
        flat = lattice and medium.offsets.shape[1] == 1
        narrow = not waves or (flat and reach > 1.5 * spacing)
        solid = medium.components > 1
        wide = 2 * spacing if solid else max(reach, 2 * spacing)
        radius = self.radius or (spacing if narrow else wide if lattice else 1.5 * spacing)
        largest = self.wavenumber or (
            (1.5 if solid else 1) / spacing if operator else 0.25 / spacing if waves else min(6 / extent, 0.1 / spacing)
        )
        count = self.wavenumbers or (10 if operator else 5)
        smallest = self.smallest or (largest / 40 if operator else largest / count)
        return Recipe(
            operator=operator,
            dispersion=self.dispersion or ("discrete" if waves and lattice else "local"),
            discrete=(self.time or ("discrete" if waves else "continuous")) == "discrete",
            radius=radius,
            cone=np.radians(self.cone or (45.0 if waves else 180.0)),
            thin=self.thin
            or (max(1, int(np.ceil(radius / spacing / 3 - 1e-9))) if waves and not operator and not flat else 1),
            snapped=(self.normals or ("lattice" if waves and lattice else "free")) == "lattice",
            angle=np.radians((15.0 if solid else 30.0 if operator else 45.0) if self.angle is None else self.angle),
            angles=self.angles,
            balanced=self.balanced,
            wavenumbers=np.linspace(smallest, largest, count),
            regularization=(3.0 if solid else 1.0) if operator and self.regularization is None else self.regularization,
            rcond=self.rcond,
        )

    def step_limit(self, order: int, coefficient: float, spacing: float, dim: int) -> float:
        """Return the largest step at which fitted values are safe for diffusion: they act like a stencil over one
        spacing, whatever the reach of the model's stencil.
        """
        return np.inf if order == 2 else 0.75 * spacing**2 / (2 * dim * coefficient)

    def depth(self, medium: Medium, spacing: float, extent: float) -> float:
        """Return the radius of the clouds."""
        return self.recipe(medium, spacing, extent).radius

    def update(self, fringe: OutlineNodes, halo: np.ndarray, medium: Medium) -> sparse.csr_array:
        """Return the rows for the halo nodes (positions in the fringe) over the new level and earlier ones, shape (H, 3
        S) for waves, (H, 2 S) for diffusion.
        """
        points, places = fringe.with_images(self.depth(medium, fringe.spacing, fringe.extent))
        recipe = self.recipe(medium, fringe.spacing, fringe.extent)
        matrix, condition = _fitted_rows(points, halo, fringe.normals[halo], medium, recipe, fringe.spacing)
        count, size = medium.components, len(fringe.points)
        fringe.remarks.append(
            f"condition number at most {condition:.1e}, norm of V at most {np.abs(matrix.data).max():.3g} "
            f"(remark 1: {_CONDITION:g} and {_NORM:g})"
        )
        entries = matrix.tocoo()
        part, column = np.divmod(entries.col, len(points))  # of each level, then of each component
        shape = (count * len(halo), (medium.order + 1) * count * size)
        return sparse.csr_array((entries.data, (entries.row, (part + count) * size + places[column])), shape=shape)


def update_matrix(
    points: np.ndarray,
    absorbing: np.ndarray,
    normals: np.ndarray,
    medium: Medium,
    condition: PlaneWave | None = None,
    *,
    spacing: float | None = None,
    extent: float | None = None,
    enclosing: bool = True,
) -> sparse.csr_array:
    """Return the matrix that yields the next values of absorbing nodes from those of all nodes at the present step and,
    for waves, at the one before.

    Parameters
    ----------
    points : ndarray, shape (N, dim)
        Nodes of a lattice or a mesh, or any other points.
    absorbing : ndarray of int, shape (A,)
        Nodes whose values are fitted.
    normals : ndarray, shape (A, dim)
        Outward normals, of any length.
    medium : Medium
    condition : PlaneWave, optional
    spacing : float, optional
        Distance between nodes; the median distance to the nearest node unless given.
    extent : float, optional
        Half the extent of the nodes.
    enclosing : bool
        Whether to refuse absorbing nodes that do not enclose the others.

    Returns
    -------
    csr_array, shape (A, order * N)
        ``new[absorbing] = matrix @ concatenate([u, u_before])``, or ``matrix @ u`` for diffusion.

    Raises
    ------
    InputError
        If points and normals do not match, a cloud has no neighbours, absorbing nodes do not enclose the others, or
        modes overflow.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> line = np.linspace(-1, 1, 41)[:, None]
    >>> ends, outwards = np.array([0, 40]), np.array([[-1.0], [1.0]])
    >>> matrix = fh.update_matrix(line, ends, outwards, fh.Medium(order=2, coefficient=1.0, dt=0.01))
    >>> matrix.shape  # new[ends] = matrix @ concatenate([u, u_before])
    (2, 82)
    """
    points, normals = kinds.array(points, "points", finite=False), kinds.array(normals, "normals")
    wanted = kinds.array(absorbing, "absorbing")
    absorbing = np.clip(wanted, -1, 2**53).astype(np.int64)
    if wanted.ndim != 1 or (wanted != absorbing).any():
        raise InputError("absorbing nodes are numbers of points", value=wanted.tolist(), key="absorbing")
    kinds.instance(medium, "medium", Medium, "a Medium")
    if condition is not None:
        kinds.instance(condition, "condition", PlaneWave, "a PlaneWave")
    spacing = None if spacing is None else kinds.number(spacing, "spacing", above=0)
    extent = None if extent is None else kinds.number(extent, "extent", above=0)
    _check_points(points, absorbing, normals)
    if kinds.flag(enclosing, "enclosing"):
        _check_enclosing(points, absorbing)
    if spacing is None:
        spacing = float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))
    if extent is None:
        extent = float(np.ptp(points, axis=0).max()) / 2
    recipe = (condition or PlaneWave()).recipe(medium, spacing, extent)
    return _fitted_rows(points, absorbing, normals, medium, recipe, spacing)[0]


def _fitted_rows(
    points: np.ndarray, absorbing: np.ndarray, normals: np.ndarray, medium: Medium, recipe: Recipe, spacing: float
) -> tuple[sparse.csr_array, float]:
    """Return the matrix of `update_matrix`, and the largest condition number of a fit; for a field of d components
    those of the first one come first, shape (d A, order d N).
    """
    units = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    if recipe.snapped:
        units = _snapped(units)
    near = cKDTree(points).query_ball_point(points[absorbing], recipe.radius * (1 + 1e-9))
    outwards = wavevectors(recipe, points.shape[1], medium.order)
    # in the plane the modes are a mirror image of themselves
    mirrored = points.shape[1] == 2 and medium.square
    fits: dict[tuple[bytes, bytes], modes.Fit] = {}
    rows, columns, weights, count = [], [], [], medium.components
    for number, (centre, normal, members_of_cloud) in enumerate(zip(absorbing, units, near, strict=True)):
        members = np.array(members_of_cloud)
        # + 0: no negative zeros, because equal clouds are recognised by their bytes
        steps = np.round((points[members] - points[centre]) / spacing, 6) + 0.0
        chosen = cloud(spacing * steps, normal, spacing, recipe)
        if chosen.size < 2:
            raise InputError(
                "a cloud has no neighbours",
                value=points[centre].tolist(),
                limit="at least one node besides its centre",
                key="boundary.radius",
                remedy=f"a radius above {recipe.radius:g}, or a wider cone",
            )
        oriented, steps = _oriented(normal, steps[chosen]) if mirrored else (normal, steps[chosen])
        order = np.lexsort(steps.T)
        chosen, steps = chosen[order], steps[order]
        key = oriented.tobytes(), steps.tobytes()
        if key not in fits:
            fits[key] = _fitted(recipe, medium, spacing, outwards @ modes.frame(oriented), spacing * steps)
        for level, values in enumerate(fits[key].weights):
            table = values.reshape(chosen.size, count, count)
            for component, read_component in np.ndindex(count, count):
                rows.append(np.full(chosen.size, component * absorbing.size + number))
                columns.append((level * count + read_component) * len(points) + members[chosen])
                weights.append(table[:, read_component, component])
    shape = (count * absorbing.size, medium.order * count * len(points))
    matrix = sparse.csr_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    return matrix, max(fit.condition for fit in fits.values())


def cloud(places: np.ndarray, normal: np.ndarray, spacing: float, recipe: Recipe) -> np.ndarray:
    """Indices of the points (J, dim), the origin included, in a cloud about the origin: within radius and cone (closed)
    about the inward normal, thinned to those nearest to a coarser grid.

    Hermann et al. 2023, eq 54 and figure 7. The paper's cone is open and thus excludes the diagonals, which matter.
    """
    slack, narrow = 1e-6 * spacing, np.cos(recipe.cone)

    def within(at: np.ndarray, inwards: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(at, axis=1)
        return np.asarray((distance <= recipe.radius + slack) & (inwards >= narrow * distance - slack))

    chosen = np.flatnonzero(within(places, -places @ normal))
    if recipe.thin == 1 or not chosen.size:
        return chosen
    wide = recipe.thin * spacing
    steps = wide * np.arange(-int(recipe.radius / wide + 1e-6), int(recipe.radius / wide + 1e-6) + 1)
    grid = np.stack(np.meshgrid(*[steps] * len(normal), indexing="ij"), axis=-1).reshape(-1, len(normal))
    targets = grid[within(grid, -grid[:, 0])] @ modes.frame(normal)
    return np.unique(chosen[cKDTree(places[chosen]).query(targets)[1]])


def wavevectors(recipe: Recipe, dim: int, order: int) -> np.ndarray:
    """Return wavevectors for an outward normal along the first axis, real for waves, imaginary for diffusion; shape (M,
    dim).
    """
    k = (recipe.wavenumbers[:, None, None] * modes.outward(dim, recipe.angle, recipe.angles, recipe.balanced)).reshape(
        -1, dim
    )
    return k if order == 2 else 1j * k


def _fitted(recipe: Recipe, medium: Medium, spacing: float, k: np.ndarray, places: np.ndarray) -> modes.Fit:
    """Return the fit of a cloud's nodes to wavevectors k."""
    k, symbol, polar = medium.waves(k, recipe.dispersion)
    factor = modes.factors(symbol, medium.dt, medium.order, medium.damping, recipe.discrete)
    fitted = modes.CloudModes(modes.phases(k, places), factor, symbol, polar)
    if not recipe.operator:
        return modes.fit(fitted, medium.order, regularization=recipe.regularization, rcond=recipe.rcond)
    centre = int(np.argmin(np.abs(places).sum(1)))
    rate = medium.coefficient / spacing**2
    return modes.fit_operator(fitted, centre, medium.dt, medium.order, rate, recipe.regularization or 0.0)


def _oriented(normal: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a normal and the nodes of its cloud, mirrored and with axes exchanged such that the components of the
    normal are not negative and do not increase: clouds that are images of each other have one fit.
    """
    axes = np.argsort(-np.abs(normal), kind="stable")
    signs = np.where(normal < 0, -1.0, 1.0)
    return (signs * normal)[axes] + 0.0, (signs * steps)[:, axes] + 0.0


def _snapped(normals: np.ndarray) -> np.ndarray:
    """Return the nearest of the directions between a lattice node and its 3^dim - 1 neighbours."""
    dim = normals.shape[1]
    ways = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    ways = ways[np.abs(ways).sum(1) > 0]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return np.asarray(ways[np.argmax(np.round(normals @ ways.T, 9), axis=1)])


def _check_points(points: np.ndarray, absorbing: np.ndarray, normals: np.ndarray) -> None:
    if points.ndim != 2 or not 1 <= points.shape[1] <= 3 or not np.isfinite(points).all():
        raise InputError("points must be finite, of 1 to 3 coordinates each", value=points.shape, key="points")
    if not absorbing.size or absorbing.min() < 0 or absorbing.max() >= len(points):
        raise InputError(
            "absorbing nodes are numbers of points",
            value=absorbing.tolist()[:5],
            limit=f"0 to {len(points) - 1}",
            key="absorbing",
        )
    if normals.shape != (absorbing.size, points.shape[1]) or not (np.linalg.norm(normals, axis=1) > 0).all():
        raise InputError(
            "each absorbing node needs a normal of nonzero length",
            value=normals.shape,
            limit=(absorbing.size, points.shape[1]),
            key="normals",
        )


def _check_enclosing(points: np.ndarray, absorbing: np.ndarray) -> None:
    """Refuse absorbing nodes whose convex hull does not contain all points."""
    inner_points = np.delete(points, absorbing, axis=0)
    if not len(inner_points):
        raise InputError("all nodes are absorbing", value=len(points), key="absorbing", remedy="leave a near field")
    size = float(np.ptp(points, axis=0).max())
    if points.shape[1] == 1:
        beyond = np.maximum(points[absorbing].min() - inner_points, inner_points - points[absorbing].max()).ravel()
    else:
        try:
            faces = ConvexHull(points[absorbing]).equations
        except (QhullError, ValueError):
            beyond = np.full(len(inner_points), size)
        else:
            beyond = (inner_points @ faces[:, :-1].T + faces[:, -1]).max(1)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 1e-6 * size:
        raise InputError(
            "the absorbing nodes do not enclose the near field",
            value=inner_points[worst].tolist(),
            key="absorbing",
            limit="points within their convex hull",
            remedy="absorbing nodes all along the outline, or enclosing=False where others close it",
        )


def largest_update(matrix: Any) -> float:
    """Return the largest sum of the magnitudes of a row of weights; with forward Euler, no value ever grows if it is at
    most 1 here and in the near field.
    """
    return float(np.abs(matrix).sum(axis=1).max())
