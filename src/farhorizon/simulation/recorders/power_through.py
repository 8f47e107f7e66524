"""Power through surfaces, bond by bond: exactly what leaves one part of the medium and enters the other."""

from __future__ import annotations

from functools import reduce
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.sparse import csr_array

from farhorizon import kinds
from farhorizon.arguments import Frequencies, OneOf
from farhorizon.errors import InputError, shown
from farhorizon.files.records import Recorded
from farhorizon.geometry.shapes import Shape
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.flux import plane
from farhorizon.simulation.recorders.fourier_sums import FourierSums
from farhorizon.simulation.recorders.receivers import as_frequencies, check_frequencies
from farhorizon.simulation.recorders.recorder import Arrays, Plane, RecordRequest, RowRecorder, Window, check_begun
from farhorizon.simulation.setup.compatibility import check_lossless
from farhorizon.simulation.setup.setup import Setup

_SYMMETRIC = 1e-12  # asymmetry relative to the largest weight of a bond


class PowerThrough(RowRecorder):
    r"""Power of waves through surfaces, recorded in every step: the sum over the bonds that cross them.

    It is passed to a run in ``observe=[...]``. A bond of weights w between nodes x inside and y outside carries out of
    the inside the power

    .. math:: -\tfrac{1}{2}\,m\,(u_y - u_x) \cdot w\,(v_y + v_x),

    the force in the bond times the mean velocity of its ends, with ``v = (u(t + dt) - u(t - dt)) / (2 dt)`` and m the
    mass of a node. This, times dt, is the energy that the inside loses from half a step before to half a step after
    (that of `Simulation.energies`, in which bonds across the edge count half): exactly, where nothing is damped and no
    source acts there. Where forces follow from states p of the nodes (with absent bonds, varying moduli or in 3D), a
    bond carries :math:`-m\,(v_x \cdot D p_y + v_y \cdot D p_x)` in addition to the contribution of its spring, and the
    energy of each state belongs to its node.

    Parameters
    ----------
    surfaces : Shape, (str, float), or sequence of these
        A region, for the power that leaves it; or a plane, ``("x", 2.5)``, half-way between two nodes, for the power
        that crosses it towards larger coordinates within the near field, where states count only between nodes all of
        whose bonds lie in the near field. No bond through a surface, and none from which the states of its ends follow,
        may lead beyond the near field, for a plane along its normal: a plane must keep away from layers, sponges and
        fixed sides by as many nodes as these bonds reach.
    frequencies : array_like, shape (F,)
        In cycles per unit of time, at which `energy` gives the transmitted energy; memory is by frequency, not by time.
    name : str
        Name that distinguishes several of them in one run.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
        The centre of the nodes of each region, and of the part of each plane in the lattice.
    times : ndarray, shape (rows,)
        Times of the steps from the first on; the power of a step is known after the next one.
    data : dict of str to ndarray
        "power", shape (rows, n); in two dimensions per unit thickness.
    frequencies : ndarray, shape (F,)

    Raises
    ------
    InputError
        An object that is neither a region nor a plane, a negative frequency. When the simulation is created: no waves,
        bonds that are nonlinear or break or are cut later, a region without nodes, a plane outside the near field,
        bonds through a surface that lead beyond it, frequencies that no wave on the lattice has.

    Notes
    -----
    The power of a bond is that of Silling and Lehoucq (2010), Adv. Appl. Mech. 44, section 3, where the energy of a
    pair is divided equally.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> power = fh.PowerThrough(fh.Disc(4.0))
    >>> lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0))
    >>> start = {"u": "exp(-x**2 - y**2)"}
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial=start, observe=[power])
    >>> energy = sim.energy()
    >>> _ = sim.run(until=20.0)
    >>> bool(abs(sim.dt * power.data["power"].sum() / energy - 1) < 0.02)  # nearly all has left the disc
    True
    """

    shared = unbroken = True
    before = after = 1
    sums: FourierSums

    tag: ClassVar[str] = "power"

    def __init__(
        self,
        surfaces: Annotated[
            Any, OneOf(region=Annotated[Shape, "Region whose outgoing power is recorded."], plane=Plane)
        ],
        frequencies: Frequencies = (),
        name: str = "power",
    ) -> None:
        super().__init__(name)
        single = isinstance(surfaces, Shape) or (
            isinstance(surfaces, tuple) and bool(surfaces) and isinstance(surfaces[0], str)
        )
        self.surfaces = (surfaces,) if single else tuple(kinds.sequence(surfaces, "power.surfaces", "surfaces"))
        for surface in self.surfaces:
            if not isinstance(surface, Shape) and not (isinstance(surface, list | tuple) and len(surface) == 2):
                raise InputError(
                    "a surface is the edge of a region, or a plane",
                    value=kinds.said(surface),
                    limit="a shape, or an axis and a position",
                    key="power.surfaces",
                    remedy='Box(...), Disc(...), or ("x", 2.5)',
                )
        if not self.surfaces:
            raise InputError(
                "there is no surface", value="none", limit="at least 1", key="power.surfaces", remedy="give one"
            )
        self.frequencies = as_frequencies(frequencies, "power.frequencies")
        self.points = np.zeros((0, 1))
        self._begin_rows({"power": np.zeros((0, len(self.surfaces)))})

    def __repr__(self) -> str:
        return f"PowerThrough({', '.join(map(str, self.surfaces))})"

    @property
    def asked(self) -> Arrays:
        """The points and the frequencies."""
        return {**super().asked, "frequencies": self.frequencies}

    def energy(self) -> np.ndarray:
        r"""Energy that has passed through each surface, by frequency: integrated over positive frequencies, it equals
        the integral of the power over time.

        With the Fourier sums U of the field on the nodes next to a surface it is

        .. math:: \frac{\sin \omega \Delta t}{\Delta t}\,\mathrm{Im} \sum (U_y - U_x)^* \cdot m w (U_y + U_x)

        over its bonds. Once the field has come to rest, as much energy leaves a region as the sources in it supply at
        that frequency, to rounding error.

        Returns
        -------
        ndarray, shape (F, n)

        Raises
        ------
        InputError
            There has not been a run.
        """
        check_begun(self.points.size > 0, "energy", "power")
        sums, dt = self.sums.values, self.dt
        through = [np.einsum("fi,fi->f", sums.conj(), (form @ sums.T).T).imag for form in self._forms]
        return np.sin(2 * np.pi * self.frequencies * dt)[:, None] / dt * np.stack(through, axis=-1)

    @property
    def recorded(self) -> Recorded:
        """The recorded data, independent of the run."""
        spectra = {"energy": self.energy()} if self.frequencies.size else {}
        labels = tuple(_label(*surface) for surface in zip(self.surfaces, self.points, strict=False))
        return Recorded(self.name, self.points, self.times, self.data, self.frequencies, spectra, labels=labels)

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        _check_bonds(setup, parts)
        check_lossless(setup.model, "power", "Receivers around the surface")
        check_frequencies(self.frequencies, parts.near, "power.frequencies")
        surfaces = [_surface_of(surface, parts) for surface in self.surfaces]
        crossing, passes = [_crossing(parts, surface) for surface in surfaces], parts.grid.engine.passes
        nodes = np.unique(np.concatenate([bonds.ends.ravel() for bonds in crossing]))
        if passes is not None:
            states = _states_at(parts, nodes)
            crossing = [_of_known(states, *pair, parts) for pair in zip(crossing, surfaces, strict=True)]
            nodes = np.union1d(nodes, states.places)
        self.points = np.array([surface.middle for surface in surfaces])
        self.dt = parts.near.dt
        mass = parts.near.mass
        self._forms = [
            _form(np.searchsorted(nodes, bonds.ends), mass * bonds.weights, len(nodes)) for bonds in crossing
        ]
        if passes is not None:
            divergences = mass * passes.sums.divergence
            of_states = [states.form(nodes, bonds.ends, divergences[bonds.offsets]) for bonds in crossing]
            self._forms = [of_springs + form for of_springs, form in zip(self._forms, of_states, strict=True)]
        self.sums = FourierSums(self.frequencies, self.dt, parts.near.stencil.components * len(nodes))
        return RecordRequest(nodes, ())

    def rows(self, window: Window) -> Arrays:
        earlier, now, later = (
            values.reshape(len(values), np.prod(values.shape[1:], dtype=int)) for values in window.values
        )
        twice = later - earlier
        # row by row in the same order, however many steps are added at once: a run that is resumed has the same rows
        pulls = (np.ascontiguousarray((form @ twice.T).T) for form in self._forms)
        powers = [-(now * pull).sum(1) / (4 * self.dt) for pull in pulls]
        return {"power": np.stack(powers, axis=-1)}


def _label(given: Any, middle: np.ndarray) -> str:
    """Return the label of a surface in pictures."""
    if isinstance(given, Shape):
        return f"{type(given).__name__.lower()} around ({', '.join(f'{x:.4g}' for x in middle)})"
    return f"plane {given[0]} = {middle['xyz'.index(given[0])]:.4g}"


class _Surface(NamedTuple):
    """A surface between nodes."""

    given: Any  # a shape, or (str, float)
    # axes along which bonds that cross the surface must not lead out of the near field; along the others a plane ends
    # at its edge
    axes: list[int]
    # for each node of this part of the lattice and within one reach around it, an index that increases across the
    # surface
    sides: np.ndarray
    middle: np.ndarray  # shape (dim,)


def _surface_of(given: Any, parts: RunParts) -> _Surface:
    """Return a region or a plane as a surface between nodes; raises InputError if there is no node in the region, or no
    such plane. A region is continued periodically across all sides of the lattice, a plane across periodic ones.
    """
    part, lattice, team = parts.near.lattice, parts.whole.near.lattice, parts.whole.team
    reach = parts.near.stencil.reach
    indices = [np.arange(first - m, first + n + m) for first, n, m in zip(part.first, part.shape, reach, strict=True)]
    if not isinstance(given, Shape):
        try:
            axis, row = plane(lattice, *given)
        except InputError as error:
            raise error.at("power.surfaces") from None
        rows_past = indices[axis] - row - 1
        sides = (
            rows_past // lattice.shape[axis] if parts.whole.sides[axis, -1].periodic else (rows_past >= 0).astype(int)
        )
        other_axes = [a for a in range(lattice.dim) if a != axis]
        middle = (lattice.lower + lattice.upper) / 2
        middle[axis] = lattice.lower[axis] + (row + 0.5) * lattice.spacing
        shape = [len(along) for along in indices]
        return _Surface(given, [axis], np.broadcast_to(np.expand_dims(sides, other_axes), shape), middle)
    axes = [along[places % len(along)] for along, places in zip(lattice.axes, indices, strict=True)]
    inside = np.asarray(given.contains(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)))
    nodes = np.argwhere(inside[tuple(slice(m, -m or None) for m in reach)]) + np.array(part.first)
    total, count = map(sum, zip(*team.gather((nodes.sum(axis=0), len(nodes))), strict=True))
    if not count:
        raise InputError(
            "no node of the near field lies in the region",
            value=repr(given),
            limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
            key="power.surfaces",
            remedy="move it inside or enlarge the lattice",
        )
    in_near_field = [
        parts.whole.sides[a, -1].periodic | ((along >= 0) & (along < lattice.shape[a]))
        for a, along in enumerate(indices)
    ]
    inside = inside & reduce(np.logical_and.outer, in_near_field)
    middle = lattice.lower + lattice.spacing * total / count
    return _Surface(given, list(range(lattice.dim)), (~inside).astype(int), middle)


def _check_bonds(setup: Setup, parts: RunParts) -> None:
    """Raise InputError unless the bonds are those of a linear wave equation and do not change."""
    model, weights = parts.near.model, parts.grid.engine.weights
    # the remedy: the energy flux of the continuum, from stresses and velocities
    receivers, reason = 'Receivers with record = "energy_flux", up to their interpolation', None
    if model.order != 2:
        reason = "a field that diffuses carries no energy of waves", "Simulation.power_across, which tells the heat"
    elif model.bond_law is not None:
        reason = "the power of bonds that are nonlinear, break or are strained by heat is not known", receivers
    elif any(crack.opens for crack in setup.cracks):
        reason = "cracks that open later change the bonds", f"cracks from the start on; or {receivers}"
    elif weights.ndim > 1 and np.abs(weights - weights.swapaxes(1, 2)).max() > _SYMMETRIC * np.abs(weights).max():
        reason = "the weights of bonds are no symmetric matrices", receivers
    if reason is not None:
        raise InputError(
            reason[0],
            value=model.title,
            limit="linear waves by symmetric bonds that stay",
            key="power",
            remedy=reason[1],
        )


class _Bonds(NamedTuple):
    """Bonds across a surface."""

    ends: np.ndarray  # flat numbers of the nodes inside and outside, shape (bonds, 2)
    offsets: np.ndarray  # number of the offset of each, shape (bonds,)
    weights: np.ndarray  # what is left of them, with states those of the springs next to these; shape (bonds, c, c)


def _crossing(parts: RunParts, surface: _Surface) -> _Bonds:
    """Return the bonds of the near field, including those across periodic sides, from nodes inside to nodes outside, of
    which each process examines those of its nodes; raises InputError if some lead beyond the near field.
    """
    grid, engine, part, lattice = parts.grid, parts.grid.engine, parts.near.lattice, parts.whole.near.lattice
    reach, shape, sides = np.array(parts.near.stencil.reach), np.array(lattice.shape), surface.sides
    # only nodes within one reach of the surface have bonds that cross it
    next_to_surface = maximum_filter(sides, 2 * reach + 1) != minimum_filter(sides, 2 * reach + 1)
    own_index = np.argwhere(next_to_surface[tuple(slice(m, -m or None) for m in reach)])
    index, here = own_index + np.array(part.first), grid.nodes.reshape(part.shape)[tuple(own_index.T)]
    side = sides[tuple((own_index + reach).T)]
    wraps = np.array([parts.whole.sides[a, -1].periodic for a in range(lattice.dim)])
    ends, weights = [np.zeros((0, 3), np.int64)], [np.zeros((0, engine.components, engine.components))]
    for number, (offset, weight) in enumerate(zip(engine.offsets, engine.weights, strict=True)):
        step = offset[grid.lead :]
        neighbours = np.where(wraps, (index + step) % shape, index + step)
        outside, side_change = (
            (neighbours < 0) | (neighbours >= shape),
            sides[tuple((own_index + reach + step).T)] - side,
        )
        within, crosses = ~outside.any(axis=1), side_change > 0
        leads_out = outside[:, surface.axes].any(axis=1) & (side_change != 0)
        some = np.flatnonzero(crosses & within | leads_out)
        factor_left = engine.absent.left(here[some], here[some] + grid.layout.distances[number], weight)
        if (factor_left[leads_out[some]] > 0).any():
            raise _leads_out(parts, surface)
        existing, factor_left = some[factor_left > 0], factor_left[factor_left > 0]
        pair_nodes = (np.ravel_multi_index(tuple(nodes[existing].T), lattice.shape) for nodes in (index, neighbours))
        ends.append(np.stack([*pair_nodes, np.full(len(existing), number)], axis=-1))
        weights.append(factor_left[:, None, None] * weight.reshape(engine.components, engine.components))
    of_all = parts.whole.team.gather((np.concatenate(ends), np.concatenate(weights)))
    numbers, all_weights = map(np.concatenate, zip(*of_all, strict=True))
    order = np.lexsort((numbers[:, 0], numbers[:, 2]))  # as on a single process
    return _Bonds(numbers[order, :2], numbers[order, 2], all_weights[order])


def _of_known(states: _NodeStates, bonds: _Bonds, surface: _Surface, parts: RunParts) -> _Bonds:
    """Return the bonds whose ends both have known states; where a plane ends, some may not. Raises InputError if states
    next to the surface depend on what lies beyond the near field.
    """
    known = states.knows(bonds.ends)
    if not known[:, surface.axes].all():
        raise _leads_out(parts, surface)
    return _Bonds(*(table[known.all(axis=1)] for table in bonds))


def _leads_out(parts: RunParts, surface: _Surface) -> InputError:
    nodes = max(parts.near.stencil.reach[a] for a in surface.axes)  # for states, that of both passes together
    return InputError(
        "bonds through the surface lead beyond the near field",
        value=repr(surface.given),
        limit=f"{nodes} nodes of the near field between the surface and a side that bonds cross",
        key="power.surfaces",
        remedy="move the surface inwards, or enlarge the lattice",
    )


def _form(ends: np.ndarray, weights: np.ndarray, count: int) -> csr_array:
    """Return the matrix A of ``u . A w = sum over bonds of (u_y - u_x) . weights (w_y + w_x)`` on `count` nodes;
    vectors are ordered node by node.
    """
    components = weights.shape[1]
    rows, columns, values = [], [], []
    for first, sign in ((1, 1.0), (0, -1.0)):
        for second in (0, 1):
            for a in range(components):
                for b in range(components):
                    rows.append(components * ends[:, first] + a)
                    columns.append(components * ends[:, second] + b)
                    values.append(sign * weights[:, a, b])
    size = components * count
    return csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size))


# --- states of nodes -----------------------------------------------------------------------------------------------


class _NodeStates(NamedTuple):
    """States of some nodes, after the law of each node, as sums over displacements."""

    nodes: np.ndarray  # flat numbers in the lattice, sorted, shape (E,)
    # whether all displacements that a state depends on lie in the near field, along each axis; shape (E, dim)
    known: np.ndarray
    owners: np.ndarray  # for each term, the index in `nodes` of the node whose state it belongs to, shape (T,)
    places: np.ndarray  # for each term, the flat number of the node whose displacement it multiplies, shape (T,)
    terms: np.ndarray  # matrices that multiply these displacements, shape (T, n, components)

    def knows(self, ends: np.ndarray) -> np.ndarray:
        """For bonds with ends of shape (bonds, 2), whether the states of both ends are known, along each axis."""
        return np.asarray(self.known[np.searchsorted(self.nodes, ends)].all(1))

    def form(self, nodes: np.ndarray, ends: np.ndarray, divergences: np.ndarray) -> csr_array:
        """Return the matrix A of ``u . A w = sum over bonds of 2 (w_x . D p_y(u) + w_y . D p_x(u))``, given the sorted
        nodes on which u and w are given, node by node, the nodes x and y of each bond, shape (bonds, 2), and its matrix
        D, shape (bonds, components, n).
        """
        size, components = divergences.shape[2], divergences.shape[1]
        x, y = np.searchsorted(self.nodes, ends).T
        at_x, at_y = np.searchsorted(nodes, ends).T
        shape = size * len(self.nodes), components * len(nodes)
        to_states = _blocks(self.owners, np.searchsorted(nodes, self.places), self.terms, shape)
        at_ends, state_nodes = np.concatenate([at_x, at_y]), np.concatenate([y, x])
        powers = _blocks(state_nodes, at_ends, np.tile(2 * divergences.swapaxes(1, 2), (2, 1, 1)), shape)
        return csr_array(to_states.T @ powers)


def _blocks(rows: np.ndarray, columns: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> csr_array:
    """Return a sparse matrix of blocks, given their values, of shape (count, n, c), and their block rows and
    columns.
    """
    _, n, c = values.shape
    row = np.broadcast_to((n * rows)[:, None, None] + np.arange(n)[:, None], values.shape)
    column = np.broadcast_to((c * columns)[:, None, None] + np.arange(c), values.shape)
    return csr_array((values.ravel(), (row.ravel(), column.ravel())), shape=shape)


def _states_at(parts: RunParts, nodes: np.ndarray) -> _NodeStates:
    """Return the states of some nodes, given by their sorted flat numbers; each process contributes those of its own
    nodes.
    """
    engine, near, lattice = parts.grid.engine, parts.near, parts.whole.near.lattice
    passes = engine.passes
    assert passes is not None
    sums, shape = passes.sums, np.array(lattice.shape)
    inside, own_nodes = near.lattice.own(nodes)
    here, index = parts.grid.nodes.ravel()[own_nodes], np.stack(np.unravel_index(nodes[inside], lattice.shape), -1)
    wraps = np.array([parts.whole.sides[a, -1].periodic for a in range(lattice.dim)])
    dim = sums.shapes.shape[1]
    shapes, known = np.zeros((len(here), dim, dim)), np.ones((len(here), lattice.dim), bool)
    bonds, exists = [], engine.get("exists")
    for k, offset in enumerate(engine.offsets):
        neighbours = here + parts.grid.layout.distances[k]
        present = exists[here] & exists[neighbours] & ~engine.absent.is_cut(here, neighbours)
        neighbour_index = index + offset[parts.grid.lead :]
        neighbour_index = np.where(wraps, neighbour_index % shape, neighbour_index)
        within = (neighbour_index >= 0) & (neighbour_index < shape)
        known &= within | ~present[:, None]
        shapes += (exists[neighbours] if sums.kept else present)[:, None, None] * sums.shapes[k]
        bonds.append((k, np.flatnonzero(present & within.all(1)), neighbour_index))
    laws = sums.law(shapes, passes.moduli_at(here)) if len(here) else np.zeros((0, *sums.gradient.shape[1:2] * 2))
    owners, places, terms = [], [], []
    number = np.flatnonzero(inside)
    for k, existing, neighbour_index in bonds:
        term = laws[existing] @ sums.gradient[k]
        for sign, ends in ((1.0, neighbour_index[existing]), (-1.0, index[existing])):
            owners.append(number[existing])
            places.append(np.ravel_multi_index(tuple(ends.T), lattice.shape))
            terms.append(sign * term)
    of_process = number, known, *map(np.concatenate, (owners, places, terms))
    numbers, known_there, *tables = map(np.concatenate, zip(*parts.whole.team.gather(of_process), strict=True))
    all_known = np.zeros((len(nodes), lattice.dim), bool)
    all_known[numbers] = known_there
    return _NodeStates(nodes, all_known, *tables)
