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
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.recorders.flux import bonds_left, plane
from farhorizon.simulation.recorders.fourier_sums import FourierSums
from farhorizon.simulation.recorders.recorder import Arrays, Plane, RecordRequest, RowRecorder, StepValues, check_begun
from farhorizon.simulation.recorders.spectra import as_frequencies, check_frequencies
from farhorizon.simulation.recorders.state_power import NodeStates, states_at
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
        alone = isinstance(surfaces, Shape) or (
            isinstance(surfaces, tuple) and bool(surfaces) and isinstance(surfaces[0], str)
        )
        self.surfaces = (surfaces,) if alone else tuple(kinds.sequence(surfaces, "power.surfaces", "surfaces"))
        for one in self.surfaces:
            if not isinstance(one, Shape) and not (isinstance(one, list | tuple) and len(one) == 2):
                raise InputError(
                    "a surface is the edge of a region, or a plane",
                    value=kinds.said(one),
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
        sums, dt = self._sums.values, self._dt
        through = [np.einsum("fi,fi->f", sums.conj(), (form @ sums.T).T).imag for form in self._forms]
        return np.sin(2 * np.pi * self.frequencies * dt)[:, None] / dt * np.stack(through, axis=-1)

    @property
    def recorded(self) -> Recorded:
        """The recorded data, independent of the run."""
        spectra = {"energy": self.energy()} if self.frequencies.size else {}
        labels = tuple(_label(*one) for one in zip(self.surfaces, self.points, strict=False))
        return Recorded(self.name, self.points, self.times, self.data, self.frequencies, spectra, labels=labels)

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: Parts) -> RecordRequest:
        _check_bonds(setup, parts)
        check_frequencies(self.frequencies, parts.near, "power.frequencies")
        surfaces = [_surface_of(one, parts) for one in self.surfaces]
        bonds, passes = [_crossing(parts, one) for one in surfaces], parts.grid.engine.passes
        nodes = np.unique(np.concatenate([one.ends.ravel() for one in bonds]))
        if passes is not None:
            states = states_at(parts, nodes)
            bonds = [_of_known(states, one, at, parts) for one, at in zip(bonds, surfaces, strict=True)]
            nodes = np.union1d(nodes, states.places)
        self.points = np.array([one.middle for one in surfaces])
        self._dt = parts.near.dt
        mass = parts.near.mass
        self._forms = [_form(np.searchsorted(nodes, one.ends), mass * one.weights, len(nodes)) for one in bonds]
        if passes is not None:
            pushes = mass * passes.sums.divergence
            of_states = [states.form(nodes, one.ends, pushes[one.offsets]) for one in bonds]
            self._forms = [one + other for one, other in zip(self._forms, of_states, strict=True)]
        return RecordRequest(nodes, ())

    def start(self, step: int, step_values: StepValues) -> None:
        self.forget()
        self._last = step_values.nodes
        self._sums = FourierSums(self.frequencies, self._dt, int(np.prod(step_values.nodes.shape[1:])))
        self._sums.add(step, step_values.nodes[1:].reshape(1, -1))

    def add(self, step: int, step_values: StepValues) -> None:
        rows = np.concatenate([self._last, step_values.nodes]).reshape(len(step_values.nodes) + 2, -1)
        self._last = rows[-2:].reshape(2, *step_values.nodes.shape[1:])
        if self.frequencies.size:
            self._sums.add(step, rows[2:])
        now, twice = rows[1:-1], rows[2:] - rows[:-2]
        # row by row in the same order, however many steps are added at once: a run that is resumed has the same rows
        pulls = (np.ascontiguousarray((form @ twice.T).T) for form in self._forms)
        powers = [-(now * pull).sum(1) / (4 * self._dt) for pull in pulls]
        self._keep(np.arange(len(now)) + step - 1, {"power": np.stack(powers, axis=-1)})

    def state(self) -> Arrays:
        sums = {f"sums.{name}": array for name, array in self._sums.state().items()} if self.frequencies.size else {}
        return {**super().state(), "last": self._last, **sums}

    def take(self, state: Arrays) -> None:
        super().take(state)
        self._last = state["last"].copy()
        if self.frequencies.size:
            self._sums.take({name[5:]: array for name, array in state.items() if name.startswith("sums.")})


def _label(given: Any, middle: np.ndarray) -> str:
    """Return the label of a surface in pictures."""
    if isinstance(given, Shape):
        return f"{type(given).__name__.lower()} around ({', '.join(f'{x:.4g}' for x in middle)})"
    return f"plane {given[0]} = {middle['xyz'.index(given[0])]:.4g}"


class _Surface(NamedTuple):
    """A surface between nodes.

    Attributes
    ----------
    given : Shape or (str, float)
    axes : list of int
        Axes along which bonds that cross the surface must not lead out of the near field; along the others a plane ends
        at its edge.
    sides : ndarray of int
        For each node of this part of the lattice and within one reach around it, an index that increases across the
        surface.
    middle : ndarray, shape (dim,)
    """

    given: Any
    axes: list[int]
    sides: np.ndarray
    middle: np.ndarray


def _surface_of(given: Any, parts: Parts) -> _Surface:
    """Return a region or a plane as a surface between nodes. A region is continued periodically across all sides of the
    lattice, a plane across periodic ones.

    Raises
    ------
    InputError
        There is no node in the region, or no such plane.
    """
    part, lattice, team = parts.near.lattice, parts.whole.near.lattice, parts.whole.team
    more = parts.near.stencil.reach
    around = [np.arange(first - m, first + n + m) for first, n, m in zip(part.first, part.shape, more, strict=True)]
    if not isinstance(given, Shape):
        try:
            axis, row = plane(lattice, *given)
        except InputError as error:
            raise error.at("power.surfaces") from None
        past = around[axis] - row - 1
        sides = past // lattice.shape[axis] if parts.whole.sides[axis, -1].periodic else (past >= 0).astype(int)
        others = [a for a in range(lattice.dim) if a != axis]
        middle = (lattice.lower + lattice.upper) / 2
        middle[axis] = lattice.lower[axis] + (row + 0.5) * lattice.spacing
        shape = [len(along) for along in around]
        return _Surface(given, [axis], np.broadcast_to(np.expand_dims(sides, others), shape), middle)
    axes = [along[places % len(along)] for along, places in zip(lattice.axes, around, strict=True)]
    inside = np.asarray(given.contains(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)))
    nodes = np.argwhere(inside[tuple(slice(m, -m or None) for m in more)]) + np.array(part.first)
    total, count = (sum(one) for one in zip(*team.gather((nodes.sum(axis=0), len(nodes))), strict=True))
    if not count:
        raise InputError(
            "no node of the near field lies in the region",
            value=repr(given),
            limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
            key="power.surfaces",
            remedy="move it inside or enlarge the lattice",
        )
    near = [
        parts.whole.sides[a, -1].periodic | ((along >= 0) & (along < lattice.shape[a]))
        for a, along in enumerate(around)
    ]
    inside = inside & reduce(np.logical_and.outer, near)
    middle = lattice.lower + lattice.spacing * total / count
    return _Surface(given, list(range(lattice.dim)), (~inside).astype(int), middle)


def _check_bonds(setup: Setup, parts: Parts) -> None:
    """Raise InputError unless the bonds are those of a linear wave equation and do not change."""
    model, weights = parts.near.model, parts.grid.engine.weights
    # the remedy: the energy flux of the continuum, from stresses and velocities
    receivers, wrong = 'Receivers with record = "energy_flux", up to their interpolation', None
    if model.order != 2:
        wrong = "a field that diffuses carries no energy of waves", "Simulation.power_across, which tells the heat"
    elif model.bond_law is not None:
        wrong = "the power of bonds that are nonlinear, break or are strained by heat is not known", receivers
    elif any(crack.opens for crack in setup.cracks):
        wrong = "cracks that open later change the bonds", f"cracks from the start on; or {receivers}"
    elif weights.ndim > 1 and np.abs(weights - weights.swapaxes(1, 2)).max() > _SYMMETRIC * np.abs(weights).max():
        wrong = "the weights of bonds are no symmetric matrices", receivers
    if wrong is not None:
        raise InputError(
            wrong[0], value=model.title, limit="linear waves by symmetric bonds that stay", key="power", remedy=wrong[1]
        )


class _Bonds(NamedTuple):
    """Bonds across a surface.

    Attributes
    ----------
    ends : ndarray of int, shape (bonds, 2)
        Flat numbers of the nodes inside and outside.
    offsets : ndarray of int, shape (bonds,)
        Number of the offset of each.
    weights : ndarray, shape (bonds, c, c)
        Their remaining weights; for a material with states those of the springs next to these.
    """

    ends: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray


def _crossing(parts: Parts, surface: _Surface) -> _Bonds:
    """Return the bonds of the near field, including those across periodic sides, from nodes inside to nodes outside.
    Each process examines those of its nodes.

    Raises
    ------
    InputError
        Bonds through the surface lead beyond the near field.
    """
    grid, engine, part, lattice = parts.grid, parts.grid.engine, parts.near.lattice, parts.whole.near.lattice
    more, shape, sides = np.array(parts.near.stencil.reach), np.array(lattice.shape), surface.sides
    # only nodes within one reach of the surface have bonds that cross it
    beside = maximum_filter(sides, 2 * more + 1) != minimum_filter(sides, 2 * more + 1)
    own = np.argwhere(beside[tuple(slice(m, -m or None) for m in more)])
    index, here = own + np.array(part.first), grid.nodes.reshape(part.shape)[tuple(own.T)]
    side = sides[tuple((own + more).T)]
    wraps = np.array([parts.whole.sides[a, -1].periodic for a in range(lattice.dim)])
    ends, found = [np.zeros((0, 3), np.int64)], [np.zeros((0, engine.components, engine.components))]
    for number, (offset, weight) in enumerate(zip(engine.offsets, engine.weights, strict=True)):
        step = offset[grid.lead :]
        there = np.where(wraps, (index + step) % shape, index + step)
        out, rise = (there < 0) | (there >= shape), sides[tuple((own + more + step).T)] - side
        near, crosses = ~out.any(axis=1), rise > 0
        leads_out = out[:, surface.axes].any(axis=1) & (rise != 0)
        some = np.flatnonzero(crosses & near | leads_out)
        left = bonds_left(engine, here[some], here[some] + int(offset @ np.array(engine.core.stride)), weight)
        if (left[leads_out[some]] > 0).any():
            raise _leads_out(parts, surface)
        kept, left = some[left > 0], left[left > 0]
        pair = (np.ravel_multi_index(tuple(one[kept].T), lattice.shape) for one in (index, there))
        ends.append(np.stack([*pair, np.full(len(kept), number)], axis=-1))
        found.append(left[:, None, None] * weight.reshape(engine.components, engine.components))
    every = parts.whole.team.gather((np.concatenate(ends), np.concatenate(found)))
    bonds, weights = (np.concatenate(one) for one in zip(*every, strict=True))
    order = np.lexsort((bonds[:, 0], bonds[:, 2]))  # as on a single process
    return _Bonds(bonds[order, :2], bonds[order, 2], weights[order])


def _of_known(states: NodeStates, bonds: _Bonds, surface: _Surface, parts: Parts) -> _Bonds:
    """Return the bonds whose ends both have known states; where a plane ends, some may not.

    Raises
    ------
    InputError
        States next to the surface depend on what lies beyond the near field.
    """
    known = states.knows(bonds.ends)
    if not known[:, surface.axes].all():
        raise _leads_out(parts, surface)
    return _Bonds(*(one[known.all(axis=1)] for one in bonds))


def _leads_out(parts: Parts, surface: _Surface) -> InputError:
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
