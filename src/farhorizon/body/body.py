"""Linear correspondence elasticity with damage, in the plane and in space: a body with its layers, its cracks, its
loads and its energies.

Silling, Epton, Weckner, Xu and Askari (2007) with the layer of Wildman and Gazonas (2012). The loops are in
`body.body_loops`; here the box of nodes is laid out, data are checked, and results are taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from farhorizon import boundaries, kinds
from farhorizon.body import body_loops as engine
from farhorizon.body import body_report
from farhorizon.body.infinite_body import bond_weights, largest_frequency
from farhorizon.boundaries import Fixed, sides
from farhorizon.checks.certificate import BUDGET, Certificate
from farhorizon.checks.report import Report
from farhorizon.engine.threads import side_by_side
from farhorizon.errors import InputError
from farhorizon.files.results import Caution, write_checkpoint
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.inputs.cracks import as_cut, cut_bonds
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.loads import BodyForce, Traction, force_density
from farhorizon.inputs.outside import gradients
from farhorizon.inputs.sources import LISTED, check_size, checked, steady
from farhorizon.machine import available_memory
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.elastic import COMBINATIONS
from farhorizon.simulation.course import MOST_STEPS, tick
from farhorizon.simulation.described import describe
from farhorizon.simulation.guard import refuse_explosion
from farhorizon.simulation.overstretch import IntactMargin, intact_margin, look_at
from farhorizon.simulation.resume import matching
from farhorizon.simulation.run import Run, wanted_threads

PLANES = ("strain", "stress")
SHAPE_TENSORS = ("recomputed", "kept")
_PARALLEL_NODES = 4_000  # fewer finish a step before a second thread has woken up
_SHATTERS = 10.0  # a load whose first strain is so many times the critical stretch breaks whatever it meets

_ITERATIONS, _MARGIN = 100, 1.05  # of the largest frequency, which iterations find from below

Side = tuple[int, int]


def lame_constants(young: Any, poisson: Any, dim: int, plane: str = "strain") -> tuple[Any, Any]:
    """Lame's lambda and the shear modulus, numbers or arrays as what is given, for plane stress those of the plane
    problem.

    Raises
    ------
    InputError
        Young's modulus not positive, Poisson's ratio outside -1..1/2 (plane stress: -1..1), an unknown plane state.
    """
    _all_positive(young, "Young's modulus", "model.young")
    kinds.one_of(plane, "model.plane", PLANES, "unknown plane state")
    in_stress = dim == 2 and plane == "stress"
    most = 1.0 if in_stress else 0.5
    wrong = [value for value in (float(np.min(poisson)), float(np.max(poisson))) if not -1 < value < most]
    if wrong:
        raise InputError(
            "Poisson's ratio is out of range",
            value=wrong[0],
            limit=f"above -1, below {most}",
            key="model.poisson",
            remedy="0.49 for a nearly incompressible body" if wrong[0] >= most else "",
        )
    shear = young / (2 * (1 + poisson))
    lame = 2 * shear * poisson / (1 - 2 * poisson) if not in_stress else 2 * shear * poisson / (1 - poisson)
    return lame, shear


def _all_positive(value: Any, name: str, key: str) -> None:
    least = float(np.min(value))
    if not (np.isfinite(value).all() and least > 0):
        raise InputError(f"{name} must be finite and positive", value=least, limit="> 0", key=key)


def _serves(kind: type[boundaries.Side]) -> bool:
    """Whether a kind of side stands around a body: walls and layers of nodes that are damped or carry split fields."""
    return kind.split or kind.damped or not (kind.endless or kind.periodic)


class Body(Run):
    r"""A linear correspondence solid: its near field, what closes it, and its state.

    The deformation gradient and the force density of a node (Silling et al. 2007; Wildman and Gazonas 2012, eqs 2-6 to
    2-14) are

    .. math::

        e_i = \left(\sum_j w\,(u_j - u_i)\,\xi\right) K_i^{-1}, \quad K_i = \sum_j w\,\xi\,\xi, \quad
        \rho\,\ddot u_i = \sum_j w\,(\sigma_i K_i^{-1} + \sigma_j K_j^{-1})\,\xi + b_i, \quad \sigma = C : e.

    Parameters
    ----------
    lattice : Lattice
        The near field, 2D or 3D; with a `body`, nodes outside do not exist. A window is refused.
    operator : Kernel or Stencil
        Influence function times volume; its scale does not matter.
    young, poisson, density : float, ndarray or callable
        Numbers, or of a body of several materials arrays of the lattice's shape or functions of the coordinates: the
        stress of a node is that of its own constants. Beyond the near field the medium goes on along the normals as it
        is at the edge; within one reach of a layer, and in it, it must not vary along the normal.
    plane : {"strain", "stress"}
        In 2D.
    boundary : Fixed, Free, Sponge, NonlocalPML, or a mapping of sides to them
        Beyond `Fixed` (value 0) and beyond the layers the medium goes on and does not move; beyond `Free` there is
        nothing. A layer ends fixed.
    initial : mapping of "u", "v" to sequences of (ndarray, callable or float)
        One component an axis. Functions of the coordinates go on into the layers; arrays are zero there.
    loads : sequence of BodyForce and Traction
    cracks : sequence
        Cuts: shapes, points of a polyline (2D), corners of a polygon (3D).
    critical_stretch : float, optional
        Bonds whose length has grown by more than this part break for good (Silling and Askari 2005), except in the
        layers, within one reach of them, and of a fixed side. Without it none break.
    shape_tensor : {"recomputed", "kept"}
        K of a node that loses bonds: from those that are left (0 where its determinant is below a thousandth of an
        intact one), or that of the body without cracks, which softens gradually.
    drag : float
        Rate D/dt (1/time) at which a velocity moves towards the mean of its neighbours (Wildman and Gazonas 2012, eq.
        3-4). It is the rate that is a property of the body: D itself goes with the step.
    stabilisation : float
        0 to 1: part that is put back of the energy of displacements which the gradient does not see (Silling 2017); 1
        makes longitudinal waves those of the bond-based operator of the same influence function. It stiffens fracture:
        calibrate it with the critical stretch.
    balance : bool
        Record what leaves the near field, too, bond by bond, so that the `energies` add up; it takes time where sides
        are large.
    dt : float or callable, optional
        Half of the stable limit unless given; a function of that default gives another one: `WholeSteps`. The limit is
        that of the body at its start: nodes that have lost nearly all their bonds lower it.
    threads : int, optional
    observe : sequence of callable
        Called with the body every so often, see `run`.

    Attributes
    ----------
    step_count : int
    dt, time : float
    step_limit : float
        Largest stable time step.
    fast, slow : float
        Speeds of long longitudinal and transverse waves, of several materials the largest.
    varied : bool
        Whether there are several materials.
    fastest : dict of str to float
        "young", "poisson" and "density" of the material in which waves are fastest.
    largest_frequency : float
        That of the shortest waves, or of those at faces and cracks.
    fields : dict of str to ndarray
        Of the near field "u", "v" (half a step late), and "damage" (`damage`); nan where the body is not.

    Raises
    ------
    InputError
        A number out of range, a boundary that does not serve, sides that disagree on the form, a step above the limit,
        initial data that would break bonds at once, a material that varies along the normal of a layer, a load that
        would shatter what it meets, a traction beyond the near field or on a side that is not free, missing bonds in a
        layer that are not parallel to its normal, damage, loads, stabilisation or several materials with split fields.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 0.0))
    >>> kernel = fh.Kernel(2.0, 0, "gaussian", 1.0)
    >>> sides = {"all": fh.NonlocalPML(10, cross=0.1), "y+": fh.Free()}
    >>> push = fh.Traction("y+", (0.0, -1e-3), between=[(-2.0, 2.0)])
    >>> body = fh.Body(lattice, kernel, young=1.0, poisson=0.25, boundary=sides, loads=[push])
    >>> body.step(20)
    >>> bool(body.fields["u"][1][8, -1] < 0)  # what is pushed gives way
    True
    """

    def __init__(
        self,
        lattice: Lattice,
        operator: Kernel | Stencil,
        *,
        young: Any,
        poisson: Any,
        density: Any = 1.0,
        plane: str = "strain",
        boundary: Any = Fixed(),  # noqa: B008  (immutable)
        initial: Mapping[str, Sequence[Any]] | None = None,
        loads: Sequence[BodyForce | Traction] = (),
        cracks: Sequence[Any] = (),
        critical_stretch: float | None = None,
        shape_tensor: str = "recomputed",
        drag: float = 0.0,
        stabilisation: float = 0.0,
        balance: bool = False,
        dt: float | Callable[[float], float] | None = None,
        threads: int | None = None,
        observe: Sequence[Callable[[Body], None]] = (),
    ) -> None:
        self.given = {
            name: value for name, value in locals().items() if name not in ("self", "initial", "observe", "__class__")
        }
        kinds.instance(lattice, "lattice", Lattice, "a Lattice")
        kinds.instance(
            operator, "model.kernel", (Kernel, Stencil), "a Kernel or a Stencil", remedy="Kernel(horizon=3*spacing)"
        )
        loads, cracks = kinds.sequence(loads, "loads"), kinds.sequence(cracks, "cracks")
        if lattice.dim not in (2, 3) or lattice.window is not None:
            raise InputError(
                "correspondence elasticity needs a lattice of two or three dimensions with bounds",
                value=repr(lattice),
                key="lattice",
            )
        self.lattice, self.dim = lattice, lattice.dim
        self._notes: list[str] = []
        critical_stretch = (
            None if critical_stretch is None else kinds.number(critical_stretch, "model.critical_stretch", above=0)
        )
        kinds.one_of(shape_tensor, "model.shape_tensor", SHAPE_TENSORS, "unknown shape tensor")
        drag, stabilisation = (
            kinds.number(drag, "model.drag", least=0),
            kinds.number(stabilisation, "model.stabilisation", least=0, most=1),
        )
        kinds.flag(balance, "balance")
        self.stencil = (
            Stencil.from_kernel(operator, lattice.spacing, self.dim) if isinstance(operator, Kernel) else operator
        )
        if self.stencil.reaction:
            raise InputError(
                "a body has no reaction", value=self.stencil.reaction, key="model.kernel", remedy="Elastic(...)"
            )
        self._set_sides(boundary)
        self._critical, self._balance, self._stabilisation = critical_stretch, balance, stabilisation
        self._lay_out(threads)
        self._set_material({"young": young, "poisson": poisson, "density": density}, plane)
        self._set_loads(loads)
        whole = self._set_bonds(cracks)
        self._cut_tiles(whole, shape_tensor == "kept")
        self._set_step(dt, drag)
        self._set_layers()
        self._set_fields({} if initial is None else initial)
        self._check_load_strain()
        self._intact_margin = self._find_margin()
        self._refuse_in_split_form(cracks, loads, drag)
        self.given |= {"dt": self.dt}
        self.resting = self
        self._at_start(observe, int(np.prod(self.box)))
        if self.recorders:
            raise InputError(
                "a body has probes only, at its nodes",
                value=kinds.said(self.recorders[0]),
                key="observe",
                remedy="body.record(points)",
            )
        if self._intact_margin is not None:
            self.guard_steps = min(self.guard_steps, self._intact_margin.every)
        self._watched = np.zeros(0, np.int64)  # nodes whose displacements after each step are in `_seen`
        self._push = 0.0  # largest acceleration by the loads so far
        self._first = self.energies() if balance else {}

    # --- set-up
    # ------------------------------------------------------------------------------------------------------------------

    def _set_sides(self, boundary: Any) -> None:
        self.sides: dict[Side, Any] = sides(boundary, self.dim, _serves, COMBINATIONS)
        layers = [b for b in self.sides.values() if b.split]
        if len({b.form for b in layers}) > 1 or len({b.cross for b in layers}) > 1:
            raise InputError(
                "the layers of a body need one form and one cross-damping",
                value=sorted({(b.form, b.cross) for b in layers}),
                key="boundary",
            )
        if any(b.held for b in self.sides.values()):
            raise InputError("a fixed side holds displacements at zero", limit=0, key="boundary.value")
        self.split = any(b.form == "split" for b in layers)
        self._cross = layers[0].cross if layers else 0.0

    def _lay_out(self, threads: int | None) -> None:
        """Box of the near field and its layers, with a halo of one reach; three axes, of which the first has one node
        in 2D.
        """
        lead = 3 - self.dim
        self.beyond = depth = {side: b.nodes if (b.split or b.damped) else 0 for side, b in self.sides.items()}
        self._before = np.array([0] * lead + [depth[a, -1] for a in range(self.dim)])
        self._near = np.array([1] * lead + list(self.lattice.shape))
        self._box = self._before + self._near + np.array([0] * lead + [depth[a, 1] for a in range(self.dim)])
        self._reach = np.array([0] * lead + list(self.stencil.reach))
        padded = self._box + 2 * self._reach
        pitch = -(-padded[2] // 8) * 8
        self._strides = np.array([padded[1] * pitch, pitch, 1])
        self._margin = engine.CHUNK * -(-int(self._reach @ self._strides) // engine.CHUNK) + engine.CHUNK
        self._size = int(padded[0] * padded[1] * pitch) + 2 * self._margin
        self._origin = self._margin + int(self._reach @ self._strides)
        xi, w = bond_weights(self.stencil, self.lattice.spacing)
        self._triples = np.pad(self.stencil.offsets, ((0, 0), (lead, 0))).astype(np.int64)
        self._bonds = (
            self._triples @ self._strides,
            np.ascontiguousarray(np.column_stack([w[:, None] * xi, w])),
            np.ascontiguousarray(xi),
        )
        half = self._bonds[0] > 0
        self._pairs = (self._bonds[0][half], np.ascontiguousarray(w[half, None] * xi[half]))
        nodes = int(np.prod(self._box))
        wanted = wanted_threads(threads)
        self._threads = wanted if nodes >= _PARALLEL_NODES else 1

    def _view(self, flat: np.ndarray) -> np.ndarray:
        """Rows of flat arrays (rows, size) as (rows, three axes of the box)."""
        strides = (flat.strides[0], *(self._strides * flat.itemsize))
        return np.lib.stride_tricks.as_strided(flat[:, self._origin :], (flat.shape[0], *self._box), strides)

    @property
    def _near_slices(self) -> tuple[slice, ...]:
        """The near field in the box."""
        return tuple(slice(b, b + n) for b, n in zip(self._before, self._near, strict=True))

    def _shown(self, rows: np.ndarray) -> np.ndarray:
        """Box values (rows, three axes) on the near field, shape (rows, *lattice.shape)."""
        return rows[(slice(None), *self._near_slices)].reshape(rows.shape[0], *self.lattice.shape).copy()

    def _coordinates(self) -> list[np.ndarray]:
        """Coordinates of the box, one array (three axes) an axis of the lattice."""
        lead = 3 - self.dim
        axes = [
            self.lattice.lower[a] + self.lattice.spacing * (np.arange(self._box[lead + a]) - self._before[lead + a])
            for a in range(self.dim)
        ]
        grid = np.meshgrid(*axes, indexing="ij")
        return [g.reshape(tuple(self._box)) for g in grid]

    def _set_material(self, given: Mapping[str, Any], plane: str) -> None:
        """Constants of the nodes, and the largest wave speeds."""
        young, poisson, density = (self._on_nodes(value, f"model.{name}") for name, value in given.items())
        _all_positive(density, "the density", "model.density")
        self.lame, self.shear = lame_constants(young, poisson, self.dim, plane)
        self.density = density
        fast, slow = np.sqrt((self.lame + 2 * self.shear) / density), np.sqrt(self.shear / density)
        self._fast = np.broadcast_to(fast, self.lattice.shape)
        self.fast, self.slow, self._slowest = float(np.max(fast)), float(np.max(slow)), float(np.min(slow))
        self._reference = float(np.max(density))
        self.varied = any(np.ndim(value) > 0 for value in (young, poisson, density))
        place = int(np.argmax(self._fast))
        shown = zip(given, (young, poisson, density), strict=True)
        self.fastest = {name: float(np.broadcast_to(value, self.lattice.shape).flat[place]) for name, value in shown}
        pull = self._stabilisation * (self.lame + 2 * self.shear)
        rows = [value / self._reference for value in (self.lame, self.shear, pull)]
        rows += [self._reference / density, density / self._reference]
        if self.varied:
            constants = np.stack([self._spread(np.broadcast_to(row, self.lattice.shape)) for row in rows])
        else:
            constants = np.repeat(np.array(rows)[:, None], engine.TILE, 1)
        self._medium = (constants, int(self.varied), self._stabilisation > 0)

    def _on_nodes(self, value: Any, key: str) -> Any:
        """A constant of the material: a number if it is the same on all nodes, else an array of the lattice's shape;
        missing nodes have one, too.
        """
        lattice = self.lattice
        value = as_given(value, lattice.dim, key, time=False)
        values = checked(value(*lattice.coordinates()) if callable(value) else value, lattice, key)
        there = np.ones(lattice.shape, bool) if lattice.mask is None else lattice.mask
        kinds.check_magnitude(values[there], key)
        first = float(values[there][0])
        if callable(value) or (values[there] != first).any():
            values = np.where(there, values, first)
            self._check_continued(values, value, key)
        return values if (values[there] != first).any() else first

    def _check_continued(self, values: np.ndarray, value: Any, key: str) -> None:
        """Layers continue the material along their normals: it must not vary there."""
        depth = {side: b.nodes for side, b in self.sides.items() if (b.split or b.damped)}
        for axis, side in depth:
            n = min(self.stencil.reach[axis] + 1, values.shape[axis])
            last = np.take(values, np.arange(n) if side < 0 else np.arange(-n, 0), axis)
            if (np.ptp(last, axis=axis) > 0).any():
                raise InputError(
                    f"the material varies along {AXES[axis]} within one reach of an absorbing side",
                    key=key,
                    limit=f"constant over the last {n} nodes",
                    remedy="enlarge the near field",
                )
        if not callable(value):  # what a function is beyond is known, see below
            self._notes += gradients(values, key, depth, self.stencil.reach)
        if callable(value) and depth:
            pads = [(depth.get((a, -1), 0), depth.get((a, 1), 0)) for a in range(self.dim)]
            beyond = np.asarray(value(*self.lattice.extended(depth).coordinates()), float)
            there = np.pad(
                np.ones(values.shape, bool) if self.lattice.mask is None else self.lattice.mask, pads, mode="edge"
            )
            if (there & (beyond != np.pad(values, pads, mode="edge"))).any():
                raise InputError(
                    "the material beyond an absorbing side is not that at the edge of the near field",
                    key=key,
                    remedy="enlarge the near field, or give an array, which goes on as it is at the edge",
                )

    def _spread(self, values: np.ndarray) -> np.ndarray:
        """Values on the near field as a flat array of the box and its halo, constant along the normals from the edges
        on.
        """
        ends = self._box - self._before - self._near
        pads = [(b + r, e + r) for b, e, r in zip(self._before, ends, self._reach, strict=True)]
        padded = np.pad(values.reshape(tuple(self._near)), pads, mode="edge")
        flat = np.full(self._size, values.flat[0])
        np.lib.stride_tricks.as_strided(flat[self._margin :], padded.shape, self._strides * flat.itemsize)[...] = padded
        return flat

    def _constant(self, row: int, part: Any = ...) -> Any:
        """A row of the constants on a part of the box, or the number that serves all nodes."""
        constants, varied, _ = self._medium
        return self._view(constants[row : row + 1])[0][part] if varied else float(constants[row, 0])

    def _set_loads(self, loads: Sequence[BodyForce | Traction]) -> None:
        self._times: list[Callable[[float], float]] = []
        values = []
        for number, load in enumerate(loads):
            kinds.instance(load, f"load[{number}]", (BodyForce, Traction), "a BodyForce or a Traction")
            value = force_density(load, self.lattice, self.sides) if isinstance(load, Traction) else load.value
            values.append(self._components(value, "load.value", False))
            self._times.append(load.time or steady)
        self._loads = np.zeros((len(values), self.dim, self._size))
        for flat, value in zip(self._loads, values, strict=True):
            self._view(flat)[(slice(None), *self._near_slices)] = (
                value[(slice(None), *self._near_slices)] / self._reference
            )

    def _components(self, values: Sequence[Any] | np.ndarray, key: str, beyond: bool) -> np.ndarray:
        """A vector field on the box, shape (dim, three axes); functions reach into the layers if `beyond`."""
        entries = (
            len(values)
            if isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim)
            else None
        )
        if entries != self.dim:
            raise InputError(
                "a vector field needs one entry a component",
                value="one for all" if entries is None else f"{entries} entries",
                limit=f"a list of {self.dim}",
                key=key,
                remedy=LISTED[self.dim],
            )
        values = as_given(values, self.dim, key, time=False)
        out = np.zeros((self.dim, *self._box))
        near = self._near_slices
        for a, value in enumerate(values):
            if callable(value):
                at = self._coordinates()
                part = ... if beyond else near
                found = kinds.array(value(*[x[part] for x in at]), f"{key}[{a}]", finite=False)
                if found.shape not in ((), out[a][part].shape):
                    raise InputError(
                        "a function returns one value a point",
                        value=f"shape {found.shape}",
                        limit=out[a][part].shape,
                        key=f"{key}[{a}]",
                    )
                out[a][part] = found
            else:
                array = kinds.array(value, f"{key}[{a}]", finite=False)
                if array.ndim and array.shape != self.lattice.shape:
                    raise InputError(
                        "an array must have the lattice's shape", value=array.shape, limit=self.lattice.shape, key=key
                    )
                out[a][near] = np.broadcast_to(array, self.lattice.shape).reshape(tuple(self._near))
        if not np.isfinite(out).all():
            raise InputError("values must be finite", value=f"{int((~np.isfinite(out)).sum())} nan or inf", key=key)
        check_size(out, key)
        if self.lattice.mask is not None:
            out *= self._exists()
        return out

    def _exists(self) -> np.ndarray:
        """Which nodes of the box are there; a body goes on along the normals into the layers."""
        if self.lattice.mask is None:
            return np.ones(tuple(self._box), bool)
        pads = [(b, t - b - n) for b, n, t in zip(self._before, self._near, self._box, strict=True)]
        return np.pad(self.lattice.mask.reshape(tuple(self._near)), pads, mode="edge")

    def _set_bonds(self, cracks: Sequence[Any]) -> np.ndarray | None:
        """Bits of the bonds that are there, shape (words, three axes of the box); None if all are and none can
        break."""
        lead, m = 3 - self.dim, self._reach
        there = np.pad(self._exists(), [(r, r) for r in m], mode="edge")
        for (axis, side), b in self.sides.items():
            if not b.bonded:
                part = [slice(None)] * 3
                width = m[lead + axis]
                part[lead + axis] = slice(None, width) if side < 0 else slice(-width, None)
                there[tuple(part)] = False
        self._present = there[tuple(slice(r, r + n) for r, n in zip(m, self._box, strict=True))]
        if there.all() and not len(cracks) and self._critical is None:
            return None
        count = len(self._triples)
        whole = np.zeros((-(-count // 64), *self._box), np.uint64)
        for k, offset in enumerate(self._triples):
            other = there[tuple(slice(r + o, r + o + n) for r, o, n in zip(m, offset, self._box, strict=True))]
            whole[k >> 6] |= (self._present & other).astype(np.uint64) << np.uint64(k & 63)
        self._uncut = whole.copy()
        lower = self.lattice.lower - self.lattice.spacing * self._before[lead:]
        for crack in cracks:
            nodes, bonds = cut_bonds(
                as_cut(crack, self.dim), lower, self.lattice.spacing, tuple(self._box[lead:]), self.stencil.offsets
            )
            grown = np.pad(nodes, ((0, 0), (lead, 0)))
            np.bitwise_and.at(whole, (bonds >> 6, *grown.T), ~(np.uint64(1) << (bonds & 63).astype(np.uint64)))
        alone = int(((whole == 0).all(0) & self._present).sum()) if len(cracks) else 0
        if alone:
            self._notes.append(f"cracks leave {alone} nodes without any bond: they move freely")
        return whole

    def _cut_tiles(self, whole: np.ndarray | None, kept: bool) -> None:
        """Tiles, their kinds and slots, the bonds and shape tensors of those that are incomplete or may become so."""
        full = np.zeros(-(-len(self._triples) // 64), np.uint64)
        for k in range(len(self._triples)):
            full[k >> 6] |= np.uint64(1) << np.uint64(k & 63)
        incomplete = np.zeros(tuple(self._box), bool) if whole is None else (whole != full[:, None, None, None]).any(0)
        end = self._before + self._near
        low, high = self._before.copy(), end.copy()
        for (axis, side), b in self.sides.items():  # no bond breaks within one reach of what is not free
            row = 3 - self.dim + axis
            if b.bonded and side < 0:
                low[row] += self._reach[row]
            elif b.bonded:
                high[row] -= self._reach[row]
        loaded = (
            (self._view(np.abs(self._loads).sum((0, 1))[None])[0] > 0)
            if len(self._loads)
            else np.zeros(tuple(self._box), bool)
        )
        cuts = [(0, self._before[2]), (self._before[2], end[2]), (end[2], self._box[2])]
        stretches = [(a, min(a + engine.TILE, b)) for first, b in cuts for a in range(first, b, engine.TILE)]
        tiles, layer, slot = [], 0, 0
        for i0 in range(self._box[0]):
            for i1 in range(self._box[1]):
                beside = not (self._before[0] <= i0 < end[0] and self._before[1] <= i1 < end[1])
                may = self._critical is not None and low[0] <= i0 < high[0] and low[1] <= i1 < high[1]
                for first, last in stretches:
                    here = (i0, i1, slice(first, last))
                    kind = engine.LAYER if beside or first < self._before[2] or first >= end[2] else 0
                    kind |= engine.BREAKABLE if may and first < high[2] and last > low[2] else 0
                    kind |= (engine.INCOMPLETE if incomplete[here].any() else 0) | (
                        engine.LOADED if loaded[here].any() else 0
                    )
                    start = self._origin + int(np.array([i0, i1, first]) @ self._strides)
                    count = int(last - first)
                    places = [
                        layer if kind & engine.LAYER else -1,
                        slot if kind & (engine.INCOMPLETE | engine.BREAKABLE) else -1,
                    ]
                    layer, slot = layer + count * (places[0] >= 0), slot + count * (places[1] >= 0)
                    tiles.append([start, count, kind, *places, i0, i1, first])
        self._tiles = np.array(tiles, np.int64)
        self._layer_count = layer
        self._slots = (np.zeros((len(full), slot), np.uint64), np.zeros((self.dim**2, slot)), full)
        if whole is not None:
            # with a kept shape tensor cracks do not change it, the ends of the body do
            for bits in (self._uncut, whole) if kept else (whole,):
                self._fill_bits(bits)
                if bits is self._uncut or not kept:
                    engine.shape_inverses(self._tiles, *self._bonds[1:], *self._slots[:2])
            self._check_layers()
        limits = (1 + (np.inf if self._critical is None else self._critical)) ** 2 * (self._bonds[2] ** 2).sum(1)
        self._fracture = (limits, low, high, kept)
        self._families = None if whole is None else self._count_bonds(self._uncut)
        self._first_bonds = -1 if whole is None else int(self._count_bonds(whole).sum())
        self._crossing = self._leaving(self._slots[0])
        self._whole = whole  # for the margin, once the step is known

    def _find_margin(self) -> IntactMargin | None:
        """Where bonds would break, but cannot; looked at each time that a longitudinal wave has crossed one reach."""
        whole, near, shape = self._whole, self._near_slices, self.lattice.shape
        del self._whole
        if whole is None or self._critical is None:
            return None
        _, low, high, _ = self._fracture
        lead = 3 - self.dim
        places = self._origin + np.tensordot(self._strides, np.indices(tuple(self._box)), 1)
        crossing = min(self.stencil.reach) * self.lattice.spacing / self.fast
        return intact_margin(
            shape,
            tuple(slice(a, b) for a, b in zip((low - self._before)[lead:], (high - self._before)[lead:], strict=True)),
            places[near].reshape(shape),
            self.stencil.offsets,
            whole[(slice(None), *near)].reshape(-1, *shape),
            self._bonds[0],
            self._bonds[2],
            (1 + self._critical) ** 2 - 1,
            True,
            max(1, int(crossing / self.dt)),
        )

    def _fill_bits(self, bits: np.ndarray) -> None:
        for _, count, _, _, slot, i0, i1, first in self._tiles:
            if slot >= 0:
                self._slots[0][:, slot : slot + count] = bits[:, i0, i1, first : first + count]

    def _check_layers(self) -> None:
        """A derivative along an axis must not see bonds along another: K is diagonal in the layers."""
        off = [a * self.dim + b for a in range(self.dim) for b in range(self.dim) if a != b]
        for tile in self._tiles:
            if (
                tile[2] & engine.LAYER
                and tile[4] >= 0
                and np.abs(self._slots[1][off, tile[4] : tile[4] + tile[1]]).max() > 1e-9
            ):
                raise InputError(
                    "missing bonds in a layer must be those of a plane along its normal",
                    key="boundary",
                    remedy="keep cracks, corners and holes in the near field, one reach away from the layers",
                )

    def _count_bonds(self, bits: np.ndarray) -> np.ndarray:
        """Bonds of each node of the box."""
        return np.unpackbits(bits.view(np.uint8).reshape(*bits.shape, 8), axis=-1).sum((0, -1))

    def _leaving(self, bits: np.ndarray) -> np.ndarray:
        """Nodes of the near field and their bonds that leave it, shape (C, 2)."""
        end = self._before + self._near
        found = [np.zeros((0, 2), np.int64)]
        if not self._balance:
            return found[0]
        distances = self._bonds[0]
        kept = np.maximum(self._near - np.abs(self._triples), 0).prod(1, dtype=float)
        needed = 16.0 * float((self._near.prod(dtype=float) - kept).sum())
        if needed > available_memory():
            raise InputError(
                "the balance needs a table of the bonds that leave the near field, which does not fit into memory",
                value=f"about {needed / 2**30:.3g} GiB",
                limit=f"{available_memory() / 2**30:.3g} GiB available",
                key="output.balance",
                remedy="leave it out, or a smaller horizon",
            )
        for start, count, kind, layer, slot, i0, i1, first in self._tiles:
            if layer >= 0:
                continue
            rows = np.array([[i0, i1, first]]) + np.outer(np.arange(count), [0, 0, 1])
            if (rows.min(0) - self._reach >= self._before).all() and (rows.max(0) + self._reach < end).all():
                continue
            for k in range(len(distances)):
                other = rows + self._triples[k]
                gone = ~((other >= self._before) & (other < end)).all(1)
                if kind & engine.INCOMPLETE:
                    gone &= (bits[k >> 6, slot : slot + count] >> np.uint64(k & 63)) & np.uint64(1) != 0
                nodes = np.flatnonzero(gone)
                found.append(np.column_stack([start + nodes, np.full(len(nodes), k)]))
        return np.concatenate(found)

    def _set_step(self, dt: float | Callable[[float], float] | None, drag: float) -> None:
        """A mode of frequency w that drag leaves a factor s >= 1 - 2 D of its velocity needs ``(w dt)^2 < 2 (1 +
        s)``."""
        self.largest_frequency = self._largest_frequency()
        limit = 2 / (drag + np.sqrt(drag**2 + self.largest_frequency**2))
        self.step_limit = float(limit)
        default = 0.5 * self.step_limit
        given = kinds.function(dt, "run.dt", "the default step")(default) if callable(dt) else dt
        self.dt = default if given is None else kinds.number(given, "run.dt", above=0)
        if not 0 < self.dt <= limit:
            raise InputError(
                "the step is out of range",
                value=self.dt,
                limit=f"{limit:.6g}",
                key="run.dt",
                remedy=f"dt = {0.5 * limit:.3g}",
            )
        self._drag = drag * self.dt

    def _largest_frequency(self) -> float:
        """From the symbol, or where bonds are missing, which makes K smaller and the body stiffer, or materials meet,
        by power iteration.
        """
        most = largest_frequency(self.stencil, self.lattice.spacing, self.fast, self.slow, self._stabilisation)
        incomplete = bool((self._tiles[:, 2] & engine.INCOMPLETE).any())
        if not incomplete and not self.varied:
            return most
        mass = self._constant(engine.MASS)
        u, out, force, p = (
            np.zeros((self.dim, self._size)),
            *(np.zeros((n, self._size)) for n in (self.dim, self.dim, self.dim**2)),
        )
        self._view(u)[...] = np.random.default_rng(1).standard_normal((self.dim, *self._box)) * self._present
        value = 0.0
        for _ in range(_ITERATIONS):
            self._view(u)[...] /= np.sqrt((mass * self._view(u) ** 2).sum())
            engine.accelerations(u, p, force, self._tiles, self._medium, self._pairs, self._bonds, self._slots, out)
            before, value = value, -float((mass * self._view(u) * self._view(out)).sum())
            u[...] = -out
            if abs(value - before) < 1e-3 * value:
                break
        found = max(most, _MARGIN * float(np.sqrt(value)))
        return found if incomplete else min(found, self._frequency_bound())

    def _frequency_bound(self) -> float:
        """That of a lighter and stiffer medium without missing bonds, in which every strain takes more energy at every
        node.
        """
        bulk, shear, dim = np.max(self.lame + 2 * self.shear / self.dim), np.max(self.shear), self.dim
        p_modulus, least = bulk + 2 * shear * (1 - 1 / dim), np.min(self.density)
        pull = self._stabilisation * np.max(self.lame + 2 * self.shear)
        return largest_frequency(
            self.stencil,
            self.lattice.spacing,
            float(np.sqrt(p_modulus / least)),
            float(np.sqrt(shear / least)),
            float(pull / p_modulus),
        )

    def _set_layers(self) -> None:
        """Stretch, shift and damping of the layers' nodes, as recursions in their slots."""
        lead = 3 - self.dim
        phi, shift, damping = np.zeros((self.dim, *self._box)), np.zeros(tuple(self._box)), np.zeros(tuple(self._box))
        for (axis, side), b in self.sides.items():
            if not (b.split or b.damped):
                continue
            fast = float(np.take(self._fast, 0 if side < 0 else -1, axis).max())
            outwards = b.stretch(self.lattice.spacing, fast) if b.split else b.damping(2, fast**2, self.lattice.spacing)
            line = [1, 1, 1]
            line[lead + axis] = b.nodes
            part = [slice(None)] * 3
            part[lead + axis] = slice(None, b.nodes) if side < 0 else slice(self._box[lead + axis] - b.nodes, None)
            values = (outwards[::-1] if side < 0 else outwards).reshape(line)
            if b.split:
                phi[axis][tuple(part)] = values
                shift[tuple(part)] = np.maximum(shift[tuple(part)], b.shift)
            else:
                damping[tuple(part)] = np.maximum(damping[tuple(part)], values)
        phi = phi + self._cross * (phi.sum(0) - phi)
        rate = phi + shift
        keep = np.exp(-rate * self.dt)
        gain = -0.5 * np.where(rate > 0, phi / np.where(rate > 0, rate, 1.0), 0.0) * (1 - keep)
        count = self._layer_count
        self._layers = (
            np.zeros((2 * self.dim**2, count)),
            *(np.zeros((self.dim, count)) for _ in range(2)),
            np.zeros(count),
        )
        self._phi = np.zeros((self.dim, count))
        for _, count, _, slot, _, i0, i1, first in self._tiles:
            if slot >= 0:
                here = (slice(None), i0, i1, slice(first, first + count))
                for to, values in (
                    (self._layers[1], keep),
                    (self._layers[2], gain),
                    (self._phi, phi),
                    (self._layers[3][None], damping[None]),
                ):
                    to[:, slot : slot + count] = values[here]

    def _set_fields(self, initial: Mapping[str, Sequence[Any]]) -> None:
        unknown = set(
            kinds.instance(initial, "initial", Mapping, "a mapping of fields to their values", remedy='{"u": [...]}')
        ) - {"u", "v"}
        if unknown:
            raise InputError("unknown initial field", value=sorted(map(str, unknown)), limit="u, v", key="initial")
        nothing = np.zeros((self.dim, 0))
        self._u, self._v = (np.zeros((self.dim, self._size)) for _ in range(2))
        self._spare = np.zeros_like(self._v) if self._drag else nothing
        self._force = np.zeros_like(self._v) if self._stabilisation else nothing
        for name, flat in (("u", self._u), ("v", self._v)):
            if name in initial:
                self._view(flat)[...] = self._components(initial[name], f"initial.{name}", True) * self._present
        self._p = np.zeros((self.dim**2, self._size))
        self._terms = np.zeros((self._threads, engine.TERMS))
        self._start = float(np.abs(self._u).max()), float(np.abs(self._v).max())
        if self.split:
            self._parts = np.repeat(self._u[None], self.dim, 0) / self.dim
            self._histories = np.zeros((self.dim, self.dim**2, self._size))
        if self._critical is not None:
            stretch = engine.largest_stretch(
                self._u, self._tiles, self._bonds, self._triples, self._slots, self._fracture
            )
            if stretch > self._critical:
                raise InputError(
                    "the initial displacements stretch bonds beyond the critical stretch",
                    value=self._critical,
                    limit=f"> {stretch:.4g}",
                    key="model.critical_stretch",
                    remedy="a smaller start, or cracks",
                )

    def _check_load_strain(self) -> None:
        """A load that is put on at once sends a wave of the strain traction / (lambda + 2 mu)."""
        if self._critical is None or not len(self._loads):
            return
        force = np.sum(
            [np.abs(load) * abs(time(0.0)) for load, time in zip(self._loads, self._times, strict=True)], axis=0
        )
        modulus = self._constant(engine.LAME) + 2 * self._constant(engine.SHEAR)
        strain = float((self._view(force) / modulus).max()) * self.lattice.spacing
        if strain > _SHATTERS * self._critical:
            raise InputError(
                "the critical stretch is far below the first strain of the load, which would shatter what it meets",
                value=self._critical,
                limit=f">= {strain / _SHATTERS:.3g}",
                key="model.critical_stretch",
                remedy="a smaller load, or one that rises in time",
            )
        if strain > self._critical:
            self._notes.append(
                f"the load's first strain, about {strain:.3g}, is above the critical stretch {self._critical:.3g}: "
                "bonds break at once"
            )

    def _refuse_in_split_form(self, cracks: Sequence[Any], loads: Sequence[Any], drag: float) -> None:
        asked = {
            "critical_stretch": self._critical is not None,
            "loads": bool(len(loads)),
            "drag": bool(drag),
            "cracks": bool(len(cracks)),
            "stabilisation": bool(self._stabilisation),
            "several materials": self.varied,
            "sponge": any(b.damped for b in self.sides.values()),
            "initial v": bool(self._v.any()),
        }
        if self.split and any(asked.values()):
            raise InputError(
                "split fields carry the whole history of the stress, which knows no damage, loads or drag",
                key="boundary.form",
                value=", ".join(name for name, given in asked.items() if given),
                remedy='form = "displacement"',
            )

    # --- the run
    # ------------------------------------------------------------------------------------------------------------------

    def step(self, count: int = 1) -> None:
        """Advance by a number of steps.

        Raises
        ------
        InputError
            A load is not finite.
        UnstableError
            The displacements became non-finite or exploded.
        """
        last = self.step_count + kinds.integer(count, "count", least=0, most=MOST_STEPS)
        while self.step_count < last:
            steps = min(self.guard_steps, last - self.step_count)
            self._advance(steps, self.step_count)
            if self.probes is not None:
                self.probes.add(self.step_count + 1, self.dt, self._seen.swapaxes(1, 2))
            tick(self, steps)
            self._guard()
            look_at(self, self._intact_margin, self._u.ravel())

    def _advance(self, count: int, done: int) -> None:
        """Advance the state by `count` steps after `done` of them."""
        self._seen = np.zeros((count, self.dim, self._watched.size))
        watched = engine.Watched(self._watched, self._seen)
        body = engine.BodyTiles(self._tiles, self._medium, self._pairs, self._bonds, self._triples, self._slots)
        if self.split:
            parts = engine.SplitState(self._u, self._parts, self._histories, self._p, self._phi)
            split = (self.dt, parts, body, watched)
            side_by_side(lambda thread: engine.advance_split(thread, count, *split), self._threads)
            return
        moments = (done + np.arange(count)) * self.dt
        factors = np.array([[time(t) for time in self._times] for t in moments], float).reshape(count, len(self._times))
        if not np.isfinite(factors).all():
            raise InputError(
                "a load is not finite",
                value=f"t = {moments[np.argmin(np.isfinite(factors).all(1))]:g}",
                key="load.time",
            )
        if factors.size:
            self._push = max(self._push, float(np.abs(factors).max(0) @ np.abs(self._loads).max((1, 2))))
        state = engine.BodyState(self._u, self._v, self._spare, self._p, self._force)
        outside = engine.BodyLoads(self._loads, factors, self._crossing)
        whole = (done, self.dt, self._drag, state, body, self._fracture, self._layers, outside, self._terms, watched)
        side_by_side(lambda thread: engine.advance(thread, count, *whole), self._threads)

    def _watch(self, nodes: np.ndarray) -> None:
        self._watched = (
            self._origin + (np.stack(np.unravel_index(nodes, tuple(self._near)), -1) + self._before) @ self._strides
        )

    def _guard(self) -> None:
        def cause() -> str:
            if self.split:
                return (
                    "forward Euler on split fields grows by half of frequency^2 dt: a smaller dt, or form = "
                    '"displacement"'
                )
            if self.broken_bonds:
                return (
                    "nodes that have lost nearly all their bonds, which lowers the stable step: a smaller dt, or "
                    'shape_tensor = "kept"'
                )
            return "a layer that grows (cross-damping stops it), or the loads"

        displacement, velocity = self._start
        scale = max(displacement + velocity * self.time + self._push * self.time**2 / 2, 1e-300)
        refuse_explosion(
            self._view(self._u)[(slice(None), *self._near_slices)].reshape(self.dim, *self.lattice.shape),
            np.asarray(self.lattice.lower, float),
            self.lattice.spacing,
            scale,
            self.step_count,
            self.time,
            cause,
        )

    def linear_map(self) -> tuple[int, Callable[[np.ndarray, int], np.ndarray]]:
        """The update of displacements, velocities and the layers' memory as a map of vectors, for a body without loads
        whose bonds do not break.

        All numbers of a vector are displacements, so that its norm depends on no unit: velocities times the step,
        remembered gradients times the spacing, remembered accelerations times the step squared.

        Returns
        -------
        size : int
            Numbers in a vector.
        advance : callable
            Vector and number of steps to the vector after them; the body's own state is overwritten.
        """
        levels = [self._view(self._u), self._view(self._v)]
        there = np.broadcast_to(self._present, levels[0].shape)
        memory, gain = self._layers[0], self._layers[2]
        kept = np.tile(gain != 0, (2 * self.dim, 1))  # a derivative's row follows its direction
        count, remembered = int(there.sum()), int(kept.sum())
        scales = np.repeat(
            [1.0, self.dt, self.lattice.spacing, self.dt**2], [count, count, remembered // 2, remembered // 2]
        )

        def advance(vector: np.ndarray, steps: int) -> np.ndarray:
            values = vector / scales
            for level, part in zip(levels, np.split(values[: 2 * count], 2), strict=True):
                level[there] = part
            memory[...] = 0
            memory[kept] = values[2 * count :]
            self._advance(steps, 1)
            return scales * np.concatenate([*(level[there] for level in levels), memory[kept]])

        return len(scales), advance

    @contextmanager
    def _as_before(self) -> Iterator[None]:
        """Whatever runs inside leaves no trace."""
        kept = {name: array.copy() for name, array in self._state().items()}
        push = self._push
        try:
            yield
        finally:
            for name, array in self._state().items():
                array[...] = kept[name]
            self._push = push

    # --- results
    # ------------------------------------------------------------------------------------------------------------------

    def displacements(self, layers: bool = False) -> np.ndarray:
        """Displacements of the near field, shape ``(dim, *lattice.shape)``, or with the `layers` of the whole box."""
        box = self._view(self._u)
        return box.reshape(self.dim, *self._box[3 - self.dim :]).copy() if layers else self._shown(box)

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the near field."""
        found = {"u": self.u, "v": self.v, "damage": self.damage()}
        return (
            found
            if self.lattice.mask is None
            else {name: np.where(self.lattice.mask, field, np.nan) for name, field in found.items()}
        )

    @property
    def notes(self) -> list[str]:
        """What is allowed, but to be known."""
        return self._notes + self._remarks

    @property
    def u(self) -> np.ndarray:
        """Displacements of the near field, shape ``(dim, *lattice.shape)``."""
        return self.displacements()

    @property
    def v(self) -> np.ndarray:
        """Velocities of the near field half a step ago, shape ``(dim, *lattice.shape)``; zero in the split form."""
        return self._shown(self._view(self._v))

    @property
    def _gradient(self) -> np.ndarray:
        """Gradient of the displacements on the box, shape (dim^2, three axes)."""
        out = np.zeros_like(self._p)
        engine.displacement_gradients(self._u, self._tiles, self._pairs, self._bonds, self._slots, out)
        return self._view(out)

    @property
    def gradient(self) -> np.ndarray:
        """Gradient of the displacements (a, b) = du_a/dx_b on the near field, shape ``(dim, dim, *lattice.shape)``."""
        return self._shown(self._gradient).reshape(self.dim, self.dim, *self.lattice.shape)

    def strain_energy(self, layers: bool = False) -> float:
        """Strain energy of the present displacements, of the near field, or with the `layers` (stabilisation left
        out)."""
        e = self._gradient if layers else self._gradient[(slice(None), *self._near_slices)]
        trace = sum(e[a * self.dim + a] for a in range(self.dim))
        mixed = sum(
            e[a * self.dim + b] * (e[a * self.dim + b] + e[b * self.dim + a])
            for a in range(self.dim)
            for b in range(self.dim)
        )
        part = (...,) if layers else self._near_slices
        density = (
            0.5
            * self._reference
            * (self._constant(engine.LAME, part) * trace**2 + self._constant(engine.SHEAR, part) * mixed)
        )
        return float(density.sum()) * self.lattice.spacing**self.dim

    def energies(self) -> dict[str, float]:
        """Energies of the near field, one step ago (at the start those of the start), and what became of them since the
        start.

        Returns
        -------
        dict of str to float
            "kinetic", "strain" (with what the stabilisation stores); since the start "work" of the loads, "broken"
            (dissipated by breaking), "drag" (dissipated by drag, and carried by it), and with `balance` "outflow" (into
            layers and sides). The sum of the first two changes by the work less the other three, to rounding: with
            velocities half a step before and after, the kinetic energy is ``v_before . v_after / 2`` per mass, which
            velocity Verlet conserves together with the strain energy. Of split fields "strain" alone is known.
        """
        if self.split:
            return {"strain": self.strain_energy()}
        names = {
            "kinetic": engine.KINETIC,
            "strain": engine.STRAIN,
            "work": engine.WORK,
            "broken": engine.BROKEN,
            "drag": engine.DRAG,
        }
        if self._balance:
            names["outflow"] = engine.OUTFLOW
        if self.step_count == 0:  # the terms of the first step tell of its beginning
            with self._as_before():
                self._advance(1, 0)
                terms = self._terms.sum(0)
                terms[[number for name, number in names.items() if name not in ("kinetic", "strain")]] = 0
        else:
            terms = self._terms.sum(0)
        total = terms * self._reference * self.lattice.spacing**self.dim
        return {name: float(total[number]) for name, number in names.items()}

    def energy(self) -> float:
        """Kinetic and strain energy of the near field, one step ago."""
        found = self.energies()
        return found.get("kinetic", 0.0) + found["strain"]

    def kinetic(self) -> float | None:
        """Kinetic energy of the near field; None of split fields, which keep no velocities."""
        if self.split:
            return None
        density = self._reference * self._constant(engine.MASS, self._near_slices)
        total = 0.5 * (density * self._view(self._v)[(slice(None), *self._near_slices)] ** 2).sum()
        return float(total) * self.lattice.spacing**self.dim

    def driven(self, t: float) -> list[np.ndarray]:
        """Factors of the loads at a time."""
        return [np.asarray(time(t), float) for time in self._times]

    def balance(self) -> dict[str, float]:
        """Where the work of the loads has gone since the start, for bodies with ``balance=True``.

        Returns
        -------
        dict of str to float
            Gains of "kinetic" and "strain" energy, "work", "broken", "drag", "outflow" as of `energies`, and the
            "residual": the work less all others, which is rounding.

        Raises
        ------
        InputError
            The body does not record it.
        """
        if not self._balance:
            raise InputError("this body records no balance", key="balance", remedy="Body(..., balance=True)")
        found = self.energies()
        found |= {name: found[name] - self._first[name] for name in ("kinetic", "strain")}
        return {**found, "residual": 2 * found["work"] - sum(found.values())}

    @property
    def broken_bonds(self) -> int:
        """Bonds broken since the start."""
        return int(self._terms[:, engine.BONDS].sum()) // 2

    def damage(self) -> np.ndarray:
        """Part of a node's bonds that are cut or broken, shape of the lattice."""
        if self._families is None:
            return np.zeros(self.lattice.shape)
        left = self._families.astype(float)
        for _, count, _, _, slot, i0, i1, first in self._tiles:
            if slot >= 0:
                left[i0, i1, first : first + count] = self._count_bonds(
                    np.ascontiguousarray(self._slots[0][:, slot : slot + count])
                )
        lost = 1 - left / np.maximum(self._families, 1)
        return self._shown(lost[None])[0]

    @property
    def nbytes(self) -> int:
        """Bytes of the state."""
        arrays = [
            self._u,
            self._v,
            self._spare,
            self._force,
            self._p,
            self._tiles,
            *self._slots,
            *self._layers,
            self._phi,
            self._loads,
        ]
        return sum(a.nbytes for a in arrays)

    def remade(self, lattice: Lattice) -> Body:
        """The intact body on another lattice, at rest: without loads and cracks, and no bond breaks; of several
        materials the fastest.
        """
        nothing = {"loads": (), "cracks": (), "critical_stretch": None, "balance": False, "threads": 1}
        return Body(**{**self.given, **nothing, **self.fastest, "lattice": lattice})

    @property
    def box(self) -> tuple[int, ...]:
        """Nodes of the near field with its layers along each axis."""
        return tuple(int(n) for n in self._box[3 - self.dim :])

    # --- before a run
    # ------------------------------------------------------------------------------------------------------------------

    @property
    def crossing(self) -> float:
        return max(self.lattice.shape) * self.lattice.spacing / self.fast

    @property
    def slow_crossing(self) -> float:
        """The time in which the slowest wave crosses the near field."""
        return max(self.lattice.shape) * self.lattice.spacing / self._slowest

    def seconds_per_step(self) -> float:
        """Time of a step on this machine now, measured for a tenth of a second; the state stays as it is."""
        with self._as_before():
            self._advance(1, self.step_count)  # the first one loads compiled programs
            count, spent = 0, 0.0
            begin = perf_counter()
            while spent < 0.1:
                self._advance(1, self.step_count)
                count, spent = count + 1, perf_counter() - begin
        return spent / count

    def certificate(self, budget: float = BUDGET, until: float = np.inf) -> Certificate:
        """Whether the update of the intact linear form is stable; see `farhorizon.body.body_report`."""
        return body_report.certify_body(self, budget, until)

    def check(self, until: float | None = None, budget: float | None = None) -> Report:
        """Step limit, stability certificate of the intact linear form, layers, memory, time, before running.

        Parameters
        ----------
        until : float, optional
            End of the run, for its estimated time.
        budget : float, optional
            Seconds for the certificate. Unless given about those of the run to `until`, from 2 to 30; 30 without
            `until`.
        """
        return body_report.report(self, until, budget)

    # --- state
    # ------------------------------------------------------------------------------------------------------------------

    def _state(self) -> dict[str, np.ndarray]:
        """All arrays that a step reads before it writes them."""
        found = {
            "u": self._u,
            "v": self._v,
            "tiles": self._tiles,
            "bonds": self._slots[0],
            "inverses": self._slots[1],
            "memory": self._layers[0],
            "books": self._terms,
        }
        return found | ({"parts": self._parts, "histories": self._histories} if self.split else {})

    def _fingerprint(self) -> dict[str, Any]:
        _, low, high, kept = self._fracture
        return {
            "run": "Body",
            "shape": list(self.lattice.shape),
            "spacing": self.lattice.spacing,
            "lower": self.lattice.lower.tolist(),
            "box": self._box.tolist(),
            "dt": self.dt,
            "drag": self._drag,
            "medium": self._medium[0].sum(1).tolist(),
            "density": self._reference,
            "split": self.split,
            "neighbours": len(self._triples),
            "weights": float(self._bonds[1].sum()),
            "critical_stretch": self._critical,
            "kept": bool(kept),
            "bonds": self._first_bonds,
            "loads": [float(np.abs(load).sum()) for load in self._loads],
            "stretch": float(self._phi.sum()),
            "memory": float(self._layers[1].sum()),
            "damping": float(self._layers[3].sum()),
            "balance": self._balance,
            "breakable": [low.tolist(), high.tolist()],
        }

    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state, bonds and the memory of the layers included, under a temporary name and rename
        it."""
        arrays = self._state()
        meta = {
            "fingerprint": self._fingerprint(),
            "step": self.step_count,
            "push": self._push,
            "start": list(self._start),
            "first": self._first,
            "cautions": self.cautions,
            "peak": self.peak,
            "extra": extra,
        }
        write_checkpoint(path, arrays, {**meta, "setup": describe(self.given, arrays)})

    def load(self, path: str | Path) -> dict[str, Any]:
        arrays, meta = matching(path, self._fingerprint())
        if arrays["books"].shape != self._terms.shape:  # another number of threads: who wrote it down does not matter
            arrays["books"] = np.concatenate([arrays["books"].sum(0)[None], np.zeros_like(self._terms[1:])])
        for name, array in self._state().items():
            array[...] = arrays[name]
        self._push, self._start, self._first = float(meta["push"]), tuple(meta["start"]), dict(meta["first"])
        self.step_count = 0
        tick(self, int(meta["step"]))
        self.cautions = [Caution(*entry) for entry in meta["cautions"]]
        self.peak = float(meta.get("peak", 0.0))
        return dict(meta["extra"])
