"""Assembly: validates lattice, model, boundaries, cracks and sources, and builds the engine from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.exact.chain import Recursion, half_weights
from farhorizon.analysis.extent import Extent, Waves, extent, largest
from farhorizon.analysis.layers.returned import Datum
from farhorizon.analysis.layers.thickness import Thickness, distance_to_side, thinnest_for_diffusion
from farhorizon.boundaries import Auto, Closure, Exact, ExactEnds, Outline, Side, names
from farhorizon.boundaries.outline import SERIES, Medium
from farhorizon.engine.engine import NEVER, Engine, Layer, Zone
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES
from farhorizon.geometry.shapes import Cut, Shape
from farhorizon.inputs.conditions import Conditions, Constraint, resolve
from farhorizon.inputs.cracks import Crack, cut_bonds
from farhorizon.inputs.incidence import Incidence, IncidentWave, check_scatterers
from farhorizon.inputs.loads import BodyForce, Traction, force_density
from farhorizon.inputs.outside import Beyond, gradients
from farhorizon.inputs.prescribed import Holds, Prescribed
from farhorizon.inputs.sources import Source, as_source, by_component, field, largest_component, parts, split, steady
from farhorizon.inputs.specimens import Specimen, place
from farhorizon.machine import available_memory
from farhorizon.medium.integrators import Euler, Verlet
from farhorizon.medium.kernel import Kernel
from farhorizon.simulation.far_field import CROSSINGS, FORESEEN, LASTING, MOST_CROSSINGS, FarField, stand_ins
from farhorizon.simulation.run import wanted_threads
from farhorizon.simulation.setup import Setup, keys

_FAINT = 1e-11  # part of the data that may touch a layer of given thickness, which may be good to rounding
_SAID = 1e-9  # part of an incident wave's signal that a note is worth


class Assembly:
    """The parts of a run put together: what `Simulation` advances.

    Attributes
    ----------
    step_limit : float
        Largest stable time step.
    engine : Engine
    stencil : Stencil
    sides : dict of (axis, side) to Side
    field_shape : tuple of int
        That of the lattice, of vectors with the components first.
    sources : list
        (space, time) of each source and load, of a vector field of each of its components, as
        `farhorizon.inputs.sources.split` gives them.
    lasting : bool
        Whether the older time level outlives a step, which the energies of bonds one by one and the work of sources
        need.
    conditions : Conditions
    incident : list of Incidence
    coefficients : dict of (axis, side) to float
        Squared speed or diffusivity of the medium at each side.
    thickness : dict of str to Thickness
        By side, what the layers that chose themselves are predicted to do.
    autos : dict of (axis, side) to Auto
        The sides that leave it to the run whether they are layers, as they are until it is known how long it is, or
        extend the domain.
    extents : dict of (axis, side) to Extent
        How far the medium is computed beyond sides that extend it.
    """

    def __init__(self, setup: Setup) -> None:
        lattice, model = setup.lattice, setup.model
        sources, cracks, coefficient, initial = setup.sources, setup.cracks, setup.coefficient, setup.initial
        constraints, specimens, loads, balance = setup.constraints, setup.specimens, setup.loads, setup.balance
        dt, dtype, rule, rim = setup.dt, setup.dtype, setup.rule, setup.rim
        assert initial is not None
        self.lattice, self.model, self.background = lattice, model, setup.background
        self.lasting = model.bond_law is not None or (model.mechanical and balance)
        self.sides = setup.sides
        self.autos = {key: b for key, b in self.sides.items() if isinstance(b, Auto)}
        self.sides |= {key: b.layer(None, model.target) for key, b in self.autos.items()}
        self._check_model(cracks, coefficient, specimens, loads)
        self._check_bonds(cracks, rim)
        threads = wanted_threads(setup.threads)
        self.rim = rim
        self.stencil = model.stencil(lattice.spacing, lattice.dim)
        self.field_shape = lattice.shape if self.stencil.components == 1 else (self.stencil.components, *lattice.shape)
        self._check_vector(constraints)
        self._check_closing()
        self._check_size()  # first: layers of stencils that reach so far take long
        self.coefficients = dict.fromkeys(self.sides, model.coefficient)
        self._layers = self._make_layers()
        self.extents: dict[tuple[int, int], Extent] = {}
        self._check_memory(dtype)
        factor = None if coefficient is None else field(coefficient, lattice, 1, "coefficient")
        if factor is not None and (factor < 0).any():
            raise InputError(
                "a coefficient must not be negative", value=float(factor.min()), limit=">= 0", key="coefficient"
            )
        self.strongest = model.strongest if factor is None else float(factor.max())
        self.varied = factor is not None and bool(np.ptp(factor) > 0)
        if factor is not None:
            self.coefficients = {key: model.coefficient * self._factor_at(factor, *key) for key in self.sides}
            self._layers = self._make_layers()
        self.conditions = self._resolve(constraints, factor)
        self._hidden = self._hide()
        self.rate_limit = (
            self.stencil.symbol_maximum * model.coefficient / lattice.spacing**2 * max(self.strongest, 1e-300)
        )
        self.rate_limit += float(self.leak().max(initial=0))
        self.step_limit = model.integrator.step_limit(self.rate_limit)
        self.dt = self._choose_step(dt)
        self.thickness: dict[str, Thickness] = {}
        self._missed: dict[tuple[str, int, float], list[str]] = {}  # sides whose layers may miss their targets
        walls = [key for key, b in self.sides.items() if not (b.endless or b.periodic)]
        waves = [s.resolved(lattice, self.stencil.reach, walls) for s in sources if isinstance(s, IncidentWave)]
        driven = [*sources, *(self._as_source(load, f"load[{i}]") for i, load in enumerate(loads))]
        try:
            self._choose_layers(initial, driven, dtype, cracks, factor, specimens)
        except InputError:
            if not self.autos:
                raise
            self.sides |= {key: b.domain(None) for key, b in self.autos.items()}
            self._layers = self._make_layers()
            self._choose_layers(initial, driven, dtype, cracks, factor, specimens)
        sources = [s for s in sources if not isinstance(s, IncidentWave)]
        self._beyond = Beyond(lattice, self.sides, model.target, self._depth(), self._near_field)
        self._beyond.notes += self.conditions.notes
        self._beyond.notes += [
            words.format(nodes, ", ".join(names), aim) for (words, nodes, aim), names in self._missed.items()
        ]
        if factor is not None:
            self._beyond.notes += gradients(factor, "the coefficient", self._beyond.targets, self.stencil.reach)
        u = self._initial("u", initial)
        v = (
            self._initial("v", initial)
            if "v" in initial and model.order == 2
            else np.broadcast_to(0.0, self.field_shape)
        )
        for name in set(map(str, initial)) - ({"u", "v"} if model.order == 2 else {"u"}):
            raise InputError(
                "unknown initial field", value=name, limit="u, v" if model.order == 2 else "u", key="initial"
            )
        self._holds = Holds(
            tuple(c for c in constraints if isinstance(c, Prescribed)),
            lattice,
            model.integrator,
            self.dt,
            self.background,
        )
        u = self._holds.start(u)
        solid, metal = self._place(specimens)
        self._check_specimens(specimens)
        u = np.where(solid, metal - self.background, u) if solid.any() else u
        self.varied |= bool(solid.any())
        self.start_u, self.start_v, self._first_solid, self._factor = u, v, int(solid.sum()), factor
        self._cracks = cracks
        cuts = [c.cut for c in self._cracks]
        self._beyond.check_cracks(cuts, self.stencil.reach)
        self._unsplit: list[Callable[..., Any]] = []
        self.sources = [
            drive
            for s, key in zip(sources, keys("source", sources), strict=True)
            for drive in self._split_source(s, key)
        ]
        self.sources += [
            drive
            for i, load in enumerate(loads)
            for drive in self._split_source(self._as_source(load, f"load[{i}]"), f"load[{i}]")
        ]
        self._drives = self.sources + [drive for _, drive in self.conditions.sources]
        self._unknown = bool(waves or self._unsplit)
        self._extend(dtype)
        self._margins = self._choose_margins(u, v, solid.astype(float) if solid.any() else factor, cuts)
        self._check_conditions()
        self._make_engine(factor, rule, dtype, threads)
        self._set_phases(np.where(solid, NEVER, 0))
        if solid.any():
            self._check_dry()
        self.closure = self._close(factor)
        self._set_bonds()
        if self.lasting:
            self.engine.record_work()
        self._cut(self._cracks)
        self._note_loose_nodes()
        self._hold_and_damp()
        self._ends = self._make_ends(factor)
        self.incident = [self._incidence(wave, factor, cuts) for wave in waves]
        self._drives += [(None, lambda t, one=one: one.source(t) / model.source_factor) for one in self.incident]

    def _check_model(
        self, cracks: Sequence[Any], coefficient: Any, specimens: Sequence[Specimen], loads: Sequence[Any]
    ) -> None:
        """Sides, bonds and phases that the model does not have."""
        model = self.model
        for (axis, side), boundary in self.sides.items():
            if not model.serves(type(boundary)):
                raise InputError(
                    f"{model.title} has no such side",
                    value=type(boundary).__name__,
                    limit=names(model.serves),
                    key=f"boundary.{AXES[axis]}{'-+'[side > 0]}",
                    remedy=model.combinations,
                )
        if not model.bonds and (len(cracks) or coefficient is not None or self.lattice.body is not None):
            key = "crack" if len(cracks) else "coefficient" if coefficient is not None else "lattice.body"
            raise InputError(
                f"the bonds of a {type(model).__name__} cannot be cut or weakened one by one",
                key=key,
                remedy="leave it out",
            )
        if model.dissolution is not None and coefficient is not None:
            raise InputError("the phases are the coefficient of a Corrosion", key="coefficient", remedy="leave it out")
        if len(specimens) and model.dissolution is None:
            raise InputError(
                "only a Corrosion has specimens", value=type(model).__name__, key="specimens", remedy="Corrosion(...)"
            )
        if len(loads) and not model.mechanical:
            raise InputError(
                "loads act on an elastic medium",
                value=type(model).__name__,
                key="load",
                remedy="a source, or a condition on a side",
            )

    @property
    def bondwise(self) -> bool:
        """Whether bonds of the near field follow a law of their own stretch, or break."""
        return self.model.bond_law is not None

    def _check_bonds(self, cracks: Sequence[Any], rim: str) -> None:
        """What bonds that follow a law of their own stretch do not have."""
        if not self.bondwise:
            return
        if rim == "fixed":
            raise InputError(
                "bonds that are nonlinear or break have no fixed rim",
                value=rim,
                key="rim",
                remedy='rim="free", or Fixed sides',
            )
        if any(c.factor for c in cracks):
            raise InputError(
                "bonds that are nonlinear or break are whole or cut", key="crack.factor", limit=0, remedy="leave it out"
            )

    def _set_bonds(self) -> None:
        """Give the engine the law of the bonds, whole and uncut, and the zone where it holds: one reach away from sides
        that are not free.
        """
        model, lattice = self.model, self.lattice
        law = model.bond_law
        if law is None:
            return
        lead = 3 - lattice.dim
        first, end, around = [0] * 3, [1] * 3, [False] * 3
        for axis, n in enumerate(lattice.shape):
            around[lead + axis] = self.sides[axis, -1].periodic
            apart = [
                0 if b.periodic or not b.bonded else self.stencil.reach[axis]
                for b in (self.sides[axis, -1], self.sides[axis, 1])
            ]
            first[lead + axis] = self._margins[axis, -1] + apart[0]
            end[lead + axis] = self._margins[axis, -1] + n - apart[1]
        stretch = law.critical_stretch_on(lattice.spacing, lattice.dim)
        limit = stretch * (2 + stretch) if law.nonlinear else 2 * stretch
        stiffness = law.bond_stiffness(self.stencil, lattice.spacing) / law.density
        zone = Zone((first[0], first[1], first[2]), (end[0], end[1], end[2]), (around[0], around[1], around[2]))
        self.engine.set_bonds(stiffness, lattice.spacing, zone, law.nonlinear, limit)
        self._zone = zone
        self._cut(())
        self._families = self._bonds_left()

    def _note_loose_nodes(self) -> None:
        alone = (
            int(((self._bonds_left() == 0) & (self._families > 0)).sum()) if self.bondwise and len(self._cracks) else 0
        )
        if alone:
            self._beyond.notes.append(f"cracks leave {alone} nodes without any bond: they move freely")

    def _bonds_left(self) -> np.ndarray:
        """Bonds of each node of the near field that are there; shape of the lattice."""
        return self.engine.alive[self._near].reshape(self.lattice.shape)

    def _check_vector(self, constraints: Sequence[Constraint | Prescribed]) -> None:
        """What fields of several components do not have."""
        if self.stencil.components == 1:
            return
        name = type(self.model).__name__
        if len(constraints):
            raise InputError(
                f"constraints are for scalar fields, not for {name}", key="constraints", remedy="a body force"
            )
        if self.background != 0:
            raise InputError(
                "the background of a vector field is zero",
                value=self.background,
                key="background",
                remedy="leave it out",
            )
        for (axis, side), boundary in self.sides.items():
            key = f"boundary.{AXES[axis]}{'-+'[side > 0]}"
            if not boundary.vectors or boundary.held:
                raise InputError(
                    f"{name} has no such side",
                    value=repr(boundary),
                    key=key,
                    limit="LatticePML, Extended, Sponge, Fixed(0), Free, Periodic",
                )

    def _check_closing(self) -> None:
        """Conditions along an outline: integrators of one stage, windows closed by one condition all around."""
        closing = {key: b for key, b in self.sides.items() if b.closing}
        self._near_field: np.ndarray | None = None  # nodes of a window that a condition closes along its outline
        if not closing:
            return
        name = type(next(iter(closing.values()))).__name__
        if not isinstance(self.model.integrator, Euler | Verlet):
            raise InputError(
                f"{name} goes along with one stage a step",
                value=self.model.integrator.name,
                key="model.integrator",
                limit="forward Euler, velocity Verlet",
                remedy='integrator="euler", or LatticePML',
            )
        if self.lattice.window is None:
            return
        if len(closing) < len(self.sides) or len({repr(b) for b in closing.values()}) > 1:
            raise InputError(
                f"{name} closes a window along its outline, all around",
                key="boundary",
                remedy="the same condition on all sides",
            )
        self._near_field = self.lattice.mask

    def _close(self, factor: np.ndarray | None) -> Closure | None:
        """The conditions along the outline; None without."""
        closing = {key: b for key, b in self.sides.items() if b.closing}
        if not closing:
            return None
        lattice, model, dx = self.lattice, self.model, self.lattice.spacing
        shape = self.engine.core.nodes[3 - lattice.dim :]
        near = np.zeros(shape, bool)
        inside = self._near[-lattice.dim :]
        near[inside] = True if self._near_field is None else self._near_field
        outline = Outline(
            self._origin,
            dx,
            near,
            lattice.window,
            closing,
            frozenset(a for (a, _), b in self.sides.items() if b.periodic),
            frozenset(key for key, b in self.sides.items() if not b.bonded),
            self.stencil.offsets,
        )
        scale = (
            1.0
            if factor is None
            else float(factor[0 if self._near_field is None else tuple(np.argwhere(self._near_field)[0])].flat[0])
        )
        kernel = model.operator if isinstance(model.operator, Kernel) else None
        medium = Medium(
            model.order,
            model.coefficient * scale,
            self.dt,
            model.damping,
            dx * self.stencil.offsets,
            self.stencil.weights * model.coefficient * scale / dx**2,
            0.0 if kernel is None else kernel.horizon,
            () if kernel is None else tuple(kernel.series(lattice.dim, SERIES)),
        )
        closure = Closure(outline, medium)
        indices = self.engine.core.node_indices().reshape(shape)
        closure.attach(self.engine, indices)
        self._check_fringe(closure, factor)
        return closure

    def _check_fringe(self, closure: Closure, factor: np.ndarray | None) -> None:
        """What a condition along the outline reads is the homogeneous medium: no other material, no body's end, no
        constraint.
        """
        lattice = self.lattice
        material = np.ones(lattice.shape) if factor is None else factor.copy()
        if lattice.body is not None and lattice.mask is not None:
            material[~lattice.mask] = np.nan
        solid = self._solid if self.model.dissolution is not None else np.zeros(0)
        for nodes in (*self._holds.nodes, self.conditions.nodes, np.flatnonzero(self.leak()), np.flatnonzero(solid)):
            material.flat[nodes] = np.nan
        pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(lattice.dim)]
        read = np.pad(material, pads, mode="edge")[tuple(closure.fringe.index.T)]
        if not np.ptp(read) == 0:
            raise InputError(
                "a condition along the outline reads metal, or nodes where the material varies, the body ends or a "
                "constraint holds",
                key="boundary",
                limit=f"uniform within {closure.fringe.depth:g} of the outline",
                remedy="enlarge the near field, or use a LatticePML",
            )

    def _incidence(self, wave: IncidentWave, factor: np.ndarray | None, cuts: Sequence[Cut]) -> Incidence:
        """What joins the total field inside a box to the scattered one outside it."""
        lattice, model = self.lattice, self.model
        if not isinstance(model.integrator, Verlet) or model.damping:
            raise InputError(
                "an incident wave travels through an undamped medium of second order",
                value=type(model).__name__,
                key="incident",
                limit="Wave or Elastic with damping = 0",
                remedy="a source, or initial data",
            )
        walls = [AXES[axis] + "-+"[side > 0] for (axis, side), b in self.sides.items() if not b.endless]
        if walls:
            self._beyond.notes.append(
                f"only what is scattered meets {', '.join(walls)}: an incident wave knows the open medium alone"
            )
        material = np.ones(lattice.shape) if factor is None else factor.copy()
        if lattice.body is not None and lattice.mask is not None:
            material[~lattice.mask] = np.nan
        check_scatterers(wave, lattice, self.stencil.reach, cuts, material)

        def operator(values: np.ndarray) -> np.ndarray:
            level = np.zeros_like(self.engine.current)
            near = self.engine.core.view(level)[self._near]
            near[...] = values.reshape(near.shape)
            return self.engine.core.view(self.engine.apply_core(level))[self._near].reshape(values.shape)

        found = Incidence(wave, lattice, self.stencil, model.coefficient * float(material.flat[0]), self.dt, operator)
        if found.pulse.lost > _SAID:
            self._beyond.notes.append(
                f"a part of {found.pulse.lost:.1g} of an incident wave's signal is shorter than the lattice carries: "
                "so much leaks from its box"
            )
        return found

    def _check_size(self) -> None:
        for axis, (n, m) in enumerate(zip(self.lattice.shape, self.stencil.reach, strict=True)):
            if n < 2 * m + 1:
                raise InputError(
                    "the near field is thinner than the stencil",
                    value=f"{n} nodes along {AXES[axis]}",
                    limit=f">= {2 * m + 1}",
                    key="lattice",
                    remedy="enlarge the lattice or refine it",
                )

    def _check_memory(self, dtype: str) -> None:
        need = self._memory_needed(np.dtype(dtype).itemsize)
        if need > available_memory():
            raise InputError(
                "the run does not fit into memory",
                value=f"about {need / 2**30:.3g} GiB for {int(np.prod(self.lattice.shape))} nodes",
                limit=f"{available_memory() / 2**30:.3g} GiB available",
                key="lattice",
                remedy="a coarser or smaller lattice, thinner layers, or float32",
            )

    def _memory_needed(self, itemsize: int) -> float:
        """Bytes at the peak, in setting up: three levels and the layers' memory once more, and about seven fields
        besides coordinates.
        """
        reach = self.stencil.reach
        more = {key: self._width(key) for key in self.sides}
        shape = [
            n + sum(width for (a, _), width in more.items() if a == axis) for axis, n in enumerate(self.lattice.shape)
        ]
        columns = [
            sum(layer.columns for (a, _), layer in self._layers.items() if a == axis)
            for axis in range(self.lattice.dim)
        ]
        nodes = [float(n + 2 * m + c) for n, m, c in zip(shape, reach, columns, strict=True)]
        sides = [2 * m * c * np.prod(nodes) / n for c, m, n in zip(columns, reach, nodes, strict=True)]
        # the edges of the first two axes
        memory = sum(sides) + (sides[0] * sides[1] / np.prod(nodes) / 2 if self.lattice.dim == 3 else 0.0)
        levels = self.model.integrator.stages(1.0, 0.0, self.lattice.dim == 1).levels + self.lasting
        bits = 8 * -(-len(self.stencil.weights) // 64) * self.bondwise
        fields = itemsize * ((levels + 3) * np.prod(nodes) + 2 * memory + sides[-1]) + 8 * 7 * np.prod(
            self.lattice.shape
        )
        return float(self.stencil.components * fields + (8 * self.lattice.dim + bits) * np.prod(self.lattice.shape))

    def _choose_step(self, dt: float | Callable[[float], float] | None) -> float:
        if dt is None or callable(dt):
            model, lattice = self.model, self.lattice
            borne = [
                b.step_limit(model.order, model.coefficient, lattice.spacing, lattice.dim) for b in self.sides.values()
            ]
            default = 0.5 * min(self.step_limit, *borne)
            if dt is None:
                return default
            dt = kinds.function(dt, "run.dt", "the default step")(default)
        dt = kinds.number(dt, "run.dt", above=0)
        if dt > self.step_limit * (1 + 1e-12):
            raise InputError(
                "the time step is above the stable limit",
                value=dt,
                limit=f"{self.step_limit:.6g}",
                key="run.dt",
                remedy=f"dt <= {0.9 * self.step_limit:.4g}, or leave dt out",
            )
        return dt

    def _initial(self, name: str, initial: Mapping[str, Any]) -> np.ndarray:
        """Initial values less the background; refuses data that the infinite medium would have beyond the near
        field."""
        level = self.background if name == "u" else 0.0
        value, key = initial.get(name, level), f"initial.{name}"
        given = (
            field(
                value if name in initial else np.full(self.field_shape, level),
                self.lattice,
                self.stencil.components,
                key,
            )
            - level
        )
        values = self._inside(given)
        if isinstance(value, np.ndarray):
            self._beyond.check_values(self._size(given if self._near_field is not None else values), key)
        elif name in initial:
            peak = float(np.abs(values).max(initial=0))
            self._beyond.check_function(self._function(value), peak, key, level, "initial value")
        return values

    def _size(self, values: np.ndarray) -> np.ndarray:
        """The largest magnitude of any component; a scalar as it is."""
        return values if self.stencil.components == 1 else np.abs(values).max(0)

    def _function(self, value: Any) -> Callable[..., Any]:
        """A value as a function of the coordinates; of vectors its size."""
        if self.stencil.components > 1:
            return largest_component(value)
        return value if callable(value) else lambda *_: value

    def _resolve(self, constraints: Sequence[Constraint | Prescribed], factor: np.ndarray | None) -> Conditions:
        if not constraints:
            return resolve((), self.lattice, self.stencil.reach)
        conductivity = self.model.coefficient / self.model.source_factor * (1.0 if factor is None else factor)
        return resolve(constraints, self.lattice, self.stencil.reach, conductivity, self.background)

    def _hide(self) -> np.ndarray | None:
        """Nodes of the lattice whose values are not of the body or window; None if there are none."""
        hidden = np.zeros(self.lattice.shape, bool) if self.lattice.mask is None else ~self.lattice.mask
        hidden.ravel()[self.conditions.images] = True
        return hidden if hidden.any() else None

    def _place(self, specimens: Sequence[Specimen]) -> tuple[np.ndarray, np.ndarray]:
        """The solid nodes and what they hold; refuses metal at and beyond an absorbing side, where all must be
        liquid."""
        dissolution = self.model.dissolution
        if dissolution is None:
            return np.zeros(self.lattice.shape, bool), np.zeros(self.lattice.shape)
        solid, metal = place(specimens, self.lattice, dissolution.saturation, self.background)
        for (axis, side), boundary in self.sides.items():
            if boundary.endless and np.take(solid, 0 if side < 0 else -1, axis).any():
                raise InputError(
                    f"a specimen touches the absorbing side {AXES[axis]}{'-+'[side > 0]}; beyond it all is liquid",
                    key="specimens",
                    remedy="enlarge the near field, or end the specimen at a Free side",
                )
        return solid, metal

    def _check_specimens(self, specimens: Sequence[Specimen]) -> None:
        """Refuse metal beyond an absorbing side."""
        for number, specimen in enumerate(specimens):
            if isinstance(specimen.where, Shape):
                shape = specimen.where
                self._beyond.check_function(
                    lambda *at, shape=shape: shape.contains(np.stack(at, -1)), 1.0, f"specimen[{number}]"
                )

    def _set_phases(self, dissolved: np.ndarray) -> None:
        """Give the engine the step at which each node of the near field became liquid (`NEVER`: solid), for a
        corrosion.
        """
        dissolution = self.model.dissolution
        if dissolution is not None:
            core = np.zeros(self.engine.core.nodes, np.int64)
            core[self._near] = dissolved.reshape(core[self._near].shape)
            self.engine.set_phases(
                core, dissolution.interface, dissolution.saturation - self.background, dissolution.limited
            )

    def _check_dry(self) -> None:
        """Metal changes by what it loses to the liquid alone: neither conditions nor sources act on it."""
        busy = np.zeros(self.lattice.shape, bool)
        busy.ravel()[np.concatenate([self.conditions.nodes, *self._holds.nodes]).astype(int)] = True
        for space, _ in self._drives:
            busy |= False if space is None else space != 0
        leak = self.leak()
        self._refuse_wet(busy | (leak > 0) if leak.size else busy)

    def _refuse_wet(self, busy: np.ndarray) -> None:
        if (busy & self._solid).any():
            raise InputError(
                "a source or a condition acts on solid nodes",
                value=f"{int((busy & self._solid).sum())} nodes",
                key="specimens",
                remedy="keep sources and conditions in the liquid",
            )

    @property
    def _solid(self) -> np.ndarray:
        """The nodes of the near field that are solid now, in a corrosion."""
        return (self.engine.dissolved[self._near] == NEVER).reshape(self.lattice.shape)

    def _check_conditions(self) -> None:
        """What lies beyond an absorbing side goes on as at the edge and comes to rest: surfaces that lose heat, or are
        held at the background.
        """
        held, leak = self._surfaces()
        if not self.conditions.nodes.size and not leak.any():
            return
        busy = (leak > 0) & self.conditions.fed(self.lattice.shape)
        busy.ravel()[self.conditions.nodes] = True
        busy &= ~held
        for (axis, side), boundary in self.sides.items():
            m = self.stencil.reach[axis] - self._margins[axis, side] + 1
            if boundary.endless and not (boundary.exact or boundary.closing) and m > 0:
                last = np.arange(m) if side < 0 else self.lattice.shape[axis] - 1 - np.arange(m)
                name = AXES[axis] + "-+"[side > 0]
                if np.take(busy, last, axis).any():
                    raise InputError(
                        f"a condition holds on nodes within one reach of the absorbing side {name}, where the medium "
                        "must come to rest",
                        key="constraints",
                        limit=f"convection to the background, or nodes held at it, on the last {m} nodes",
                        remedy="background = the temperature of the surroundings, a Free side there, or restrict the "
                        "condition by `within`",
                    )
                if any(np.ptp(np.take(surface, last, axis), axis=axis).any() for surface in (held.astype(float), leak)):
                    raise InputError(
                        f"a condition ends or varies within one reach of the absorbing side {name}, into which it "
                        "would go on",
                        key="constraints",
                        limit=f"the same on the last {m} nodes",
                        remedy="a larger near field, or restrict the condition by `within`",
                    )

    def _split_source(self, source: Any, key: str) -> list[tuple[np.ndarray | None, Callable[..., Any]]]:
        """A source as functions of space times functions of time if it splits; refuses what the near field would
        miss."""
        return [
            self._split_part(part, unit, key)
            for part, unit in by_component(source, self.lattice, self.stencil.components)
        ]

    def _as_source(self, load: BodyForce | Traction, key: str) -> Source:
        """A load as the force per volume that it is."""
        value = force_density(load, self.lattice, self.sides, key) if isinstance(load, Traction) else list(load.value)
        return as_source(Source(value, load.time or steady), self.lattice.dim, f"{key}.value")

    def _split_part(self, source: Any, unit: Any, key: str) -> tuple[np.ndarray | None, Callable[..., Any]]:
        """One part of a source, to be multiplied with `unit`; one with a unit vector is a scalar."""
        space, time = parts(source)
        whole = np.ndim(unit) == 0
        values, moment = split(source, self.lattice, self.stencil.components if whole else 1)
        if space is None or values is None:
            self._unsplit.append(self._function(time))
            return None, lambda t: unit * moment(t)
        if isinstance(space, np.ndarray):
            self._beyond.check_values(self._size(values) if whole else values, key)
        else:
            inside = self._near_field
            peak = float(np.abs(values if inside is None else values[inside]).max(initial=0))
            self._beyond.check_function(self._function(space), peak, key, missed="source value")
        return unit * values, moment

    def _inside(self, values: np.ndarray) -> np.ndarray:
        """Zero outside a body, where there are no nodes, and beyond a window's outline if a condition closes it."""
        if self._near_field is not None:
            return np.where(self._near_field, values, 0.0)
        return (
            np.where(self.lattice.mask, values, 0.0)
            if self.lattice.body is not None and self.lattice.mask is not None
            else values
        )

    def _factor_at(self, factor: np.ndarray, axis: int, side: int) -> float:
        """The largest factor on bonds within one reach of a side, for a layer goes by the fastest waves that it meets;
        that of the whole near field where nothing reaches the side.
        """
        last = np.arange(self.stencil.reach[axis] + 1)
        found = float(np.take(factor, last if side < 0 else -1 - last, axis).max())
        return found or self.strongest or 1.0

    def _make_layers(self) -> dict[tuple[int, int], Layer]:
        """The stretch of each layer that follows from the target alone or is given, by (axis, side)."""
        lattice, model = self.lattice, self.model
        half_width = max(float((lattice.upper - lattice.lower).max()) / 2, lattice.spacing)
        return {
            (axis, side): boundary.make_layer(
                model.order, self.stencil.along(axis), self.coefficients[axis, side], lattice.spacing, half_width
            )
            for (axis, side), boundary in self.sides.items()
            if boundary.stretched
        }

    @property
    def targets(self) -> dict[tuple[int, int], float]:
        """What may be missed beyond each side that absorbs, as a part of the largest value."""
        return self._beyond.targets

    @property
    def crossing(self) -> float:
        """The set-up's own unit of time: in it the fastest wave crosses the near field, or what diffuses empties it,
        ``R^2/D``.
        """
        extent = max(self.lattice.shape) * self.lattice.spacing
        return self.model.crossing(extent, max(self.strongest, 1e-300))

    def _choose_layers(
        self,
        initial: Mapping[str, Any],
        sources: Sequence[Any],
        dtype: str,
        cracks: Sequence[Any],
        factor: np.ndarray | None,
        specimens: Sequence[Specimen],
    ) -> None:
        """Put the layers that follow from the data in place of those that follow from the target alone."""
        self._choose_thickness(initial, sources, cracks, factor, specimens)
        if self.thickness:
            self._check_memory(dtype)

    def _choose_thickness(
        self,
        initial: Mapping[str, Any],
        sources: Sequence[Any],
        cracks: Sequence[Any],
        factor: np.ndarray | None,
        specimens: Sequence[Specimen],
    ) -> None:
        """Give each side whose layer chooses for itself the thinnest that keeps its target, and see what one given by
        hand keeps of its own.
        """
        layers = {
            key: b for key, b in self.sides.items() if b.stretched and b.profile is None and (b.open_ended or b.target)
        }
        if not layers:
            return
        lattice, model = self.lattice, self.model
        if model.order == 1:
            chosen = {key: b for key, b in layers.items() if b.open_ended}
            self._choose_for_diffusion(chosen, initial, sources, self._scatterers(cracks, factor), specimens)
            return
        lengths = {
            key: min(b.until or CROSSINGS * self.crossing, MOST_CROSSINGS * self.crossing) for key, b in layers.items()
        }
        # a formula looks at no course in time
        watched = max((lengths[key] for key, b in layers.items() if b.target is not None), default=0.0)
        field = FarField(
            lattice.shape,
            self.stencil,
            self.coefficients,
            lattice.spacing,
            Recursion.of(model.integrator, self.dt, model.damping),
            self.dt,
            self.sides,
            self._data(initial, sources, watched),
            FORESEEN * self.crossing,
            self._scatterers(cracks, factor),
        )
        for (axis, side), boundary in layers.items():
            wanted, until = boundary.wanted(model.target), lengths[axis, side]
            if boundary.open_ended:
                found = field.layer(axis, side, boundary, wanted, until)
                if found is not None:
                    self._take(axis, side, found, wanted)
            else:
                self._judge(
                    axis,
                    side,
                    field.returned(axis, side, self._layers[axis, side], wanted, min(until, field.foreseen)),
                    wanted,
                )

    def _take(self, axis: int, side: int, found: Thickness, wanted: float) -> None:
        """Give a side the layer that was found for it."""
        name = AXES[axis] + "-+"[side > 0]
        self._layers[axis, side], self.thickness[name] = found.layer, found
        if found.predicted > wanted:
            words = "the run is long: layers of {} nodes ({}) may miss the target {:g}"
            self._missed.setdefault((words, found.layer.columns, wanted), []).append(name)

    def _judge(self, axis: int, side: int, error: float, wanted: float) -> None:
        """Remember a side whose layer is given and predicted to miss its target."""
        if error > wanted:
            words = (
                f"layers of {{}} nodes ({{}}) are predicted to send back {error:.1g} of the largest value, more "
                f"than the target {{:g}}"
            )
            self._missed.setdefault((words, self._layers[axis, side].columns, wanted), []).append(
                AXES[axis] + "-+"[side > 0]
            )

    def _choose_for_diffusion(
        self,
        chosen: Mapping[tuple[int, int], Side],
        initial: Mapping[str, Any],
        sources: Sequence[Any],
        scatterers: np.ndarray,
        specimens: Sequence[Specimen],
    ) -> None:
        """As `_choose_thickness`; what counts is the way from the data, the metal or a condition to the side."""
        lattice, model, diffusivity = self.lattice, self.model, self.model.coefficient * self.strongest
        busy = scatterers.astype(float)
        busy.ravel()[self.conditions.nodes] = 1
        if specimens:
            busy[self._place(specimens)[0]] = 1
        data = self._data(initial, sources, 0.0)
        for (axis, side), boundary in chosen.items():
            turned = [datum.turned(axis, side).values for datum in [*data, Datum(busy, "u")]]
            distance = lattice.spacing * distance_to_side(turned)
            until = min(boundary.until or LASTING * self.crossing, MOST_CROSSINGS * self.crossing)
            wanted = boundary.wanted(model.target)
            found = thinnest_for_diffusion(lattice.spacing, diffusivity * until, distance, wanted)
            if found.predicted > wanted and boundary.target is not None:
                raise InputError(
                    "no layer keeps the target for so long a run",
                    value=wanted,
                    key="boundary.target",
                    remedy="a larger target, a shorter run, or data farther from the side",
                )
            self._take(axis, side, replace(found, until=until), wanted)

    def _data(self, initial: Mapping[str, Any], sources: Sequence[Any], until: float) -> list[Datum]:
        """What sends waves: the start, and sources over a time; pulses in the middle and beside each side where that
        cannot be known.
        """
        components, reach = self.stencil.components, max(self.stencil.reach)
        start = {
            name: field(initial[name], self.lattice, components, f"initial.{name}")
            for name in ("u", "v")
            if name in initial
        }
        found = [
            d
            for name, v in start.items()
            for d in self._by_component(self._inside(v - (self.background if name == "u" else 0.0)), name)
        ]
        times = np.arange(int(np.ceil(until / self.dt)) + 1) * self.dt
        for source in sources:
            for part, unit in (
                [(source, 1.0)] if isinstance(source, IncidentWave) else by_component(source, self.lattice, components)
            ):
                whole = components if np.ndim(unit) == 0 else 1
                space, time = (None, None) if isinstance(source, IncidentWave) else split(part, self.lattice, whole)
                if space is None or time is None:
                    return stand_ins(self.lattice.shape, reach, components)
                found += self._by_component(
                    unit * space * self.model.source_factor, "source", np.array([float(time(t)) for t in times])
                )
        return found or stand_ins(self.lattice.shape, reach, components)

    def _by_component(self, values: np.ndarray, kind: str, time: np.ndarray | None = None) -> list[Datum]:
        """A datum for each component that is not at rest."""
        time = np.zeros(0) if time is None else time
        moves = kind != "source" or bool(time.any())
        return [
            Datum(part, kind, time, i)
            for i, part in enumerate(values.reshape(-1, *self.lattice.shape))
            if moves and part.any()
        ]

    def _scatterers(self, cracks: Sequence[Any], factor: np.ndarray | None) -> np.ndarray:
        """Nodes that scatter waves: around cracks, beside nodes that do not exist, and where the medium changes."""
        lattice = self.lattice
        found = np.zeros(lattice.shape, bool)
        for crack in cracks:
            low, high = (np.asarray(bound, float) for bound in crack.cut.bounds())
            first, last = (np.round((bound - lattice.lower) / lattice.spacing).astype(int) for bound in (low, high))
            found[tuple(slice(max(a, 0), max(b, 0) + 1) for a, b in zip(first, last, strict=True))] = True
        if lattice.body is not None and lattice.mask is not None:
            found |= ~lattice.mask
        if factor is not None:
            for axis in range(lattice.dim):
                found |= np.abs(np.gradient(factor, axis=axis)) > 0
        return found

    def _extend(self, dtype: str) -> None:
        """Choose how far the medium is computed beyond the sides that extend it."""
        extended = {key: b for key, b in self.sides.items() if b.extended}
        self.extents = {key: Extent(b.nodes, b.until or np.inf) for key, b in extended.items() if b.nodes is not None}
        wanted = {key: b.wanted(self.model.target) for key, b in extended.items() if b.nodes is None}
        lengths = {b.until or self.crossing for key, b in extended.items() if key in wanted}
        if lengths:
            self.extents |= self.extents_for(wanted, max(lengths))
        if extended and self._memory_needed(np.dtype(dtype).itemsize) > available_memory():
            raise self._too_large({key: found.nodes for key, found in self.extents.items()}, np.dtype(dtype).itemsize)

    def extents_for(self, wanted: Mapping[tuple[int, int], float], until: float) -> dict[tuple[int, int], Extent]:
        """How far the medium must be computed beyond some sides for nothing to return in a run.

        Parameters
        ----------
        wanted : mapping of (axis, side) to float
            Error of each.
        until : float
            Length of the run.

        Raises
        ------
        InputError
            A domain that does not fit into memory.
        """
        model, lattice = self.model, self.lattice
        steps = max(1, int(np.ceil(until / self.dt - 1e-9)))
        rate = model.coefficient * max(self.strongest, 1e-300) / lattice.spacing**2
        medium = Waves(self.stencil, rate, model.integrator, self.dt, model.damping, steps)
        least = {key: max(0, int(medium.front - lattice.shape[key[0]]) // 2) for key in wanted}
        if self._enlarged(least) * self.stencil.components * 16 > available_memory():
            raise self._too_large(least, 8)
        data = self._emitters(medium)
        sizes = [largest(medium, datum) for datum in data]
        found: dict[tuple[int, int], Extent] = {}
        known: dict[Any, Extent] = {}
        for (axis, side), error in wanted.items():
            turned = [datum.turned(axis, side) for datum in data]
            mirror = self.sides[axis, -side].image
            normal = self.stencil.along(axis)
            like = error, mirror, normal, *(datum.values.tobytes() for datum in turned)
            if like not in known:
                known[like] = replace(
                    extent(replace(medium, stencil=normal), turned, sizes, mirror, error), until=until
                )
            found[axis, side] = known[like]
        return found

    def _enlarged(self, more: Mapping[tuple[int, int], int]) -> float:
        """Nodes of the near field with so many more beyond some sides."""
        return float(
            np.prod([float(n + more.get((a, -1), 0) + more.get((a, 1), 0)) for a, n in enumerate(self.lattice.shape)])
        )

    def _too_large(self, more: Mapping[tuple[int, int], int], itemsize: int) -> InputError:
        need = 3.0 * itemsize * self.stencil.components * self._enlarged(more)
        return InputError(
            "the extended domain does not fit into memory",
            value=f"about {need / 2**30:.3g} GiB for {self._enlarged(more):.3g} nodes",
            limit=f"{available_memory() / 2**30:.3g} GiB available",
            key="boundary",
            remedy="LatticePML, a shorter run, a larger target or float32",
        )

    def _emitters(self, medium: Waves) -> list[Datum]:
        """All that sends waves or diffuses, component by component. What is known by its place alone counts from the
        start and relative to itself.
        """
        lattice, waves = self.lattice, self.model.order == 2
        busy = np.full(lattice.shape, self._unknown or any(space is None for space, _ in self._drives))
        busy.ravel()[np.concatenate([self.conditions.nodes, *self._holds.nodes]).astype(int)] = True
        for (axis, side), boundary in self.sides.items():
            if boundary.held is not None and boundary.held != self.background:
                np.moveaxis(busy, axis, 0)[0 if side < 0 else -1] = True
        data = [
            ("u", self.start_u, np.zeros(0)),
            ("v", self.start_v, np.zeros(0)),
            ("u", busy.astype(float), np.zeros(0)),
        ]
        times = self.dt * np.arange(medium.steps if waves else 0)
        for space, time in self._drives:
            if space is not None:
                data.append(
                    (
                        "source" if waves else "u",
                        space * self.model.source_factor,
                        np.array([float(time(t)) for t in times]),
                    )
                )
        found = [
            Datum(part, kind, time) for kind, values, time in data for part in np.reshape(values, (-1, *lattice.shape))
        ]
        found = [datum for datum in found if datum.values.any() and (datum.kind != "source" or datum.time.any())]
        return found or [Datum(np.ones(lattice.shape), "u")]

    def _depth(self) -> dict[tuple[int, int], int]:
        """Nodes beyond each absorbing side at which data and sources are looked at: its layer or sponge, or one reach
        if that is more.

        Beyond an exact end and an extended side as many as the near field has.
        """
        nodes = {key: layer.columns for key, layer in self._layers.items()}
        for key, b in self.sides.items():
            if b.endless and not b.stretched:
                nodes[key] = self.lattice.shape[key[0]] if b.exact or b.extended else self._width(key)
        return {key: max(n, self.stencil.reach[key[0]]) for key, n in nodes.items()}

    def _width(self, key: tuple[int, int]) -> int:
        """Nodes of the core beyond the near field that a sponge, an extended side or a condition along the outline
        takes.
        """
        if key in self.extents:
            return self.extents[key].nodes
        return self.sides[key].width(self.stencil.reach[key[0]], self.lattice.spacing)

    def _choose_margins(
        self, u: np.ndarray, v: np.ndarray, factor: np.ndarray | None, cuts: Sequence[Cut]
    ) -> dict[tuple[int, int], int]:
        """Nodes of the core beyond the near field: a sponge, or unstretched nodes in front of a layer.

        A layer's entrance must be free of sources, data, cracks and changes of the material. One node keeps sources
        out; the others need as many more as the stencil reaches. An exact end must be free of cracks and changes of the
        material.
        """
        margins = {}
        for (axis, side), boundary in self.sides.items():
            margins[axis, side] = self._width((axis, side))
            if boundary.uniform:
                m = self.stencil.reach[axis]
                last = np.arange(m + 1) if side < 0 else self.lattice.shape[axis] - 1 - np.arange(m + 1)
                least = int(boundary.stretched)
                asked = boundary.open_ended or boundary.target is not None
                faint = 1e-3 * boundary.wanted(self.model.target) if asked else _FAINT
                busy = bool(least) and any(
                    np.abs(np.take(f, last, axis)).max() > faint * np.abs(f).max()
                    for f in (self._size(u), self._size(v))
                )
                busy |= factor is not None and bool(np.ptp(np.take(factor, last, axis), axis=axis).any())
                edge = (self.lattice.lower if side < 0 else self.lattice.upper)[axis]
                near = [
                    side * (edge - cut.bounds()[(side + 1) // 2][axis]) < (m + 1) * self.lattice.spacing for cut in cuts
                ]
                margins[axis, side] = 1 + m if busy or any(near) else least
        return margins

    def _make_engine(self, factor: np.ndarray | None, rule: str, dtype: str, threads: int) -> None:
        lattice, model = self.lattice, self.model
        lead = 3 - lattice.dim
        core = (1,) * lead + tuple(n + self._margins[a, -1] + self._margins[a, 1] for a, n in enumerate(lattice.shape))
        offsets = np.zeros((len(self.stencil.weights), 3), int)
        offsets[:, lead:] = self.stencil.offsets
        layers = {(lead + axis, side): layer for (axis, side), layer in self._layers.items()}
        periodic = frozenset(lead + a for (a, side), b in self.sides.items() if side < 0 and b.periodic)
        if isinstance(model.integrator, Verlet):
            stages = model.integrator.stages(self.dt, model.damping, lattice.dim == 1, self.lasting)
        else:
            stages = model.integrator.stages(self.dt, model.damping)
        grown = None
        if factor is not None:
            pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(lattice.dim)]
            grown = np.pad(factor, pads, mode="edge").reshape(core)
            self._check_material(grown, lead)
        self.engine = Engine(
            core,
            offsets,
            self.stencil.weights * model.coefficient / lattice.spacing**2,
            stages,
            self.dt,
            layers=layers,
            periodic=periodic,
            real=dtype,
            threads=threads,
            coefficient=grown,
            rule=rule,
        )
        self._near = tuple(
            [Ellipsis]
            + [slice(None)] * lead
            + [slice(self._margins[a, -1], self._margins[a, -1] + n) for a, n in enumerate(lattice.shape)]
        )
        self._origin = lattice.lower - lattice.spacing * np.array([self._margins[a, -1] for a in range(lattice.dim)])
        for (axis, side), boundary in self.sides.items():
            if boundary.held is not None and boundary.held != self.background:
                self._fix(lead + axis, side, boundary.held - self.background)

    def _make_ends(self, factor: np.ndarray | None) -> ExactEnds | None:
        """The exact ends, whose chains have the bonds of the last nodes; None without."""
        found = [(side, b) for (_, side), b in self.sides.items() if isinstance(b, Exact)]
        if not found:
            return None
        if factor is not None and any(factor[0 if side < 0 else -1] == 0 for side, _ in found):
            raise InputError(
                "the medium beyond an exact end needs bonds",
                value=0.0,
                limit="positive at the end",
                key="coefficient",
                remedy="Free",
            )
        recursion = Recursion.of(self.model.integrator, self.dt, self.model.damping)
        bonds = half_weights(self.stencil, self.model.coefficient / self.lattice.spacing**2)
        line = self.engine.core.node_indices().ravel()
        return ExactEnds(
            self.engine,
            ["x-" if side < 0 else "x+" for side, _ in found],
            [b for _, b in found],
            [bonds * (1.0 if factor is None else factor[0 if side < 0 else -1]) for side, _ in found],
            recursion,
            np.array(
                [line[0] + np.arange(bonds.size) if side < 0 else line[-1] - np.arange(bonds.size) for side, _ in found]
            ),
        )

    def _check_material(self, core: np.ndarray, lead: int) -> None:
        """A layer, and an exact end, continue the material along the normal: it must not vary there within one
        reach."""
        for (axis, side), boundary in self.sides.items():
            if boundary.uniform:
                n, m = core.shape[lead + axis], self.stencil.reach[axis]
                last = np.take(core, np.arange(m + 1) if side < 0 else np.arange(n - m - 1, n), lead + axis)
                if np.any(np.ptp(last, axis=lead + axis) > 0):
                    raise InputError(
                        f"the material varies along {AXES[axis]} within one reach of an absorbing side",
                        key="coefficient",
                        limit=f"constant over the last {m + 1 - self._margins[axis, side]} nodes",
                        remedy="enlarge the near field",
                    )

    def _fix(self, axis: int, side: int, value: float) -> None:
        """Set the halo of a side, in every level, to a value above the background."""
        if any(b.stretched for (a, _), b in self.sides.items() if a != axis - (3 - self.lattice.dim)):
            raise InputError(
                "a Fixed value beside a LatticePML must equal the background: the layer would have to absorb a state "
                "that never decays",
                value=value + self.background,
                limit=self.background,
                key="boundary",
                remedy="set background, or use Periodic or Free",
            )
        block = self.engine.core
        m = block.reach[axis]
        strip = tuple((slice(0, m) if side < 0 else slice(-m, None)) if a == axis else slice(None) for a in range(3))
        for level in self.engine.levels[: 3 - self.engine.stages.increments]:
            block.all(level)[strip] = value

    def _cut(self, cracks: Sequence[Crack]) -> None:
        """Absent bonds: cut by cracks, beyond a thin halo, across a free side, or to nodes outside a body."""
        engine, lead = self.engine, 3 - self.lattice.dim
        block = engine.core
        offsets = engine.offsets
        found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        shape = block.nodes[lead:]
        for crack in cracks:
            cut, lost = crack.cut, 1 - crack.factor
            crossed = self._crossed(cut)
            nodes, bonds = cut_bonds(cut, self._origin, self.lattice.spacing, shape, self.stencil.offsets)
            flat = block.origin + nodes @ np.array(block.stride[lead:])
            found.append((flat, flat + offsets[bonds] @ np.array(block.stride), lost * engine.weights[bonds]))
            if self.closure is not None and np.isin(flat, self.closure.nodes).any():
                raise InputError(
                    "a crack cuts bonds of nodes that a condition along the outline reads",
                    key="crack",
                    value=[b.tolist() for b in cut.bounds()],
                    remedy="enlarge the near field, or use a LatticePML",
                )
            for axis, side in crossed:
                *ends, weights = self._continue_crack(cut, nodes, bonds, axis, side)
                found.append((ends[0], ends[1], lost * weights))
        if self.closure is not None:
            found += self._beyond_halo(self.closure)
        found.append((np.zeros(0, np.int64), np.zeros(0, np.int64), engine.weights[:0]))
        nodes, neighbours, weights = (np.concatenate([f[i] for f in found]) for i in range(3))
        size = np.abs(weights).max(axis=tuple(range(1, weights.ndim)))
        order = np.argsort(-size, kind="stable")  # of two cracks across a bond the one that takes more counts
        nodes, neighbours, weights = nodes[order], neighbours[order], weights[order]
        _, first = np.unique(nodes * engine.layout.size + neighbours, return_index=True)
        free_rim = self.lattice.body is not None and self.rim == "free"
        bare = free_rim or not all(b.bonded for b in self.sides.values())
        engine.set_cuts(nodes[first], neighbours[first], weights[first], self._existing(free_rim) if bare else None)

    def _beyond_halo(self, closure: Closure) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Bonds of the near field beyond a halo that is thinner than the stencil reaches."""
        engine, block = self.engine, self.engine.core
        lead = 3 - self.lattice.dim
        exists = (
            engine.spread(
                np.reshape(~closure.outside, block.nodes), {(lead + a, side): 0.0 for a, side in closure.outline.sides}
            )
            > 0.5
        )
        near = block.node_indices().reshape(closure.halo.shape)[closure.outline.near]
        rows = []
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            other = near + int(offset @ np.array(block.stride))
            lost = ~exists[other]
            rows.append((near[lost], other[lost], np.full(int(lost.sum()), weight)))
        return rows

    def _crossed(self, cut: Cut) -> list[tuple[int, int]]:
        """Sides (axis, side) with a layer that a crack runs into; InputError where it crosses a sponge or a periodic
        side.

        Beyond an extended side it is cut as it is given.
        """
        crossed = []
        for (axis, side), boundary in self.sides.items():
            edge, end = (
                (self.lattice.lower, self.lattice.upper)[(side + 1) // 2][axis],
                cut.bounds()[(side + 1) // 2][axis],
            )
            if side * (end - edge) > 1e-9 * self.lattice.spacing and boundary.cracks != "end":
                if boundary.cracks == "refuse":
                    raise InputError(
                        "a crack crosses a side that cannot continue it",
                        value=AXES[axis] + "-+"[side > 0],
                        key="crack",
                        remedy="shorten it, or use a LatticePML there",
                    )
                crossed.append((axis, side))
        return crossed

    def _continue_crack(
        self, cut: Cut, nodes: np.ndarray, bonds: np.ndarray, axis: int, side: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bonds that a crack parallel to a layer's normal cuts inside the layer, from those at the core's last
        nodes."""
        block = self.engine.core
        lead = 3 - self.lattice.dim
        count, m = block.nodes[lead + axis], self.stencil.reach[axis]
        last = [count - 1 - j if side > 0 else j for j in range(m + 1)]
        found = []
        for column in last:
            at = nodes[:, axis] == column
            rest = nodes[at].copy()
            rest[:, axis] = 0
            found.append({(*r, b) for r, b in zip(rest.tolist(), bonds[at].tolist(), strict=True)})
        if any(f != found[0] for f in found):
            raise self._oblique(cut, axis, side)
        self._check_straight(cut, found[0], axis, side)
        table = np.array(sorted(found[0]), int).reshape(-1, self.lattice.dim + 1)
        columns = self._layers[axis, side].columns
        beyond = (count if side > 0 else -columns) + np.arange(columns)[:, None]
        flat = block.origin + table[:, :-1] @ np.array(block.stride[lead:]) + beyond * block.stride[lead + axis]
        other = flat + self.engine.offsets[table[:, -1]] @ np.array(block.stride)
        return flat.ravel(), other.ravel(), np.concatenate([self.engine.weights[table[:, -1]]] * columns)

    def _check_straight(self, cut: Cut, continued: set[tuple[int, ...]], axis: int, side: int) -> None:
        """Beyond the core a crack may end, but cut nothing that its straight continuation does not cut."""
        columns = self._layers[axis, side].columns
        shape = list(self.engine.core.nodes[3 - self.lattice.dim :])
        origin = self._origin.copy()
        origin[axis] += self.lattice.spacing * (shape[axis] if side > 0 else -columns)
        shape[axis] = columns
        nodes, bonds = cut_bonds(cut, origin, self.lattice.spacing, tuple(shape), self.stencil.offsets)
        nodes[:, axis] = 0
        if not {(*r, b) for r, b in zip(nodes.tolist(), bonds.tolist(), strict=True)} <= continued:
            raise self._oblique(cut, axis, side)
        if not continued:
            return
        note = (
            f"the crack that runs into the layer at {AXES[axis]}{'-+'[side > 0]} is taken to go on straight without end"
        )
        if note not in self._beyond.notes:
            self._beyond.notes.append(note)

    def _oblique(self, cut: Cut, axis: int, side: int) -> InputError:
        return InputError(
            f"a crack may run across the absorbing side {AXES[axis]}{'-+'[side > 0]} only straight along its normal, "
            "and beyond its first nodes",
            key="crack",
            value=[b.tolist() for b in cut.bounds()],
            limit=f"{self.lattice.lower.tolist()} to {self.lattice.upper.tolist()}",
            remedy="end it inside, turn it, or enlarge the near field",
        )

    def _existing(self, body: bool) -> np.ndarray:
        """True where a node of the medium is, False beyond free sides and, if wanted, outside the body; over a
        level."""
        lead = 3 - self.lattice.dim
        core = np.ones(self.engine.core.nodes)
        if body and self.lattice.body is not None and self.lattice.mask is not None:
            pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(self.lattice.dim)]
            core = np.pad(self.lattice.mask.astype(float), pads, mode="edge").reshape(core.shape)
            self._check_material(core, lead)
        beyond = {(lead + a, side): 0.0 for (a, side), b in self.sides.items() if not b.bonded}
        return self.engine.spread(core, beyond) > 0.5

    def _hold_and_damp(self) -> None:
        """Nodal factors: damping of sponges, in the core and in layers along it; nodes outside a body never move."""
        held = self.engine.outside
        if self.rim == "fixed":
            exists = self._existing(True)
            nodes = self.engine.layout.box.node_indices()
            held = nodes[~exists[nodes]]
        resting, leaking, leak = self._continued_surfaces()
        held = np.concatenate([held, resting])
        self._held = self.engine.all_components(held)
        tables = [(self._held, *np.zeros((3, len(self._held))))]
        if any(b.damped for b in self.sides.values()):
            tables.append(self._damped(held))
        tables.append((leaking, *np.ones((2, leaking.size)), leak))
        nodes, before, after, losses = (np.concatenate(columns) for columns in zip(*tables, strict=True))
        # a node belongs to one thread: a sponge's may lose heat at a surface, too
        once, at = np.unique(nodes, return_inverse=True)
        rows = [np.ones(once.size), np.ones(once.size), np.zeros(once.size)]
        for row, put, values in zip(rows, (np.multiply, np.multiply, np.add), (before, after, losses), strict=True):
            put.at(row, at, values)
        self.engine.set_damping(once, *rows)

    def _surfaces(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that conditions hold at the background, and the rates at which nodes lose heat; of the lattice's
        shape."""
        held, leak = np.zeros(self.lattice.shape, bool), self.leak()
        held.ravel()[self.conditions.nodes[self.conditions.resting]] = True
        return held, leak if leak.size else np.zeros(self.lattice.shape)

    def _continued_surfaces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes beyond the near field that go on being held at the background, and nodes that lose heat, with their
        rates, beyond it too.
        """
        core = self.engine.core
        beyond = np.ones(self.engine.layout.size, bool)
        beyond[core.node_indices()[self._near]] = False
        pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(self.lattice.dim)]
        held, leak = (
            self.engine.spread(np.pad(f.astype(float), pads, mode="edge").reshape(core.nodes)) for f in self._surfaces()
        )
        places = self.engine.layout.box.node_indices()
        resting, leaking = places[(held[places] > 0) & beyond[places]], places[leak[places] > 0]
        return resting, leaking, leak[leaking]

    def _damped(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Nodes of the sponges but those held, their factors on the old and the new increment, their loss rate."""
        layout, lead = self.engine.layout, 3 - self.lattice.dim
        rate = np.zeros(layout.box.nodes)
        for (axis, side), boundary in self.sides.items():
            if boundary.damped:
                values = boundary.damping(self.model.order, self.coefficients[axis, side], self.lattice.spacing)
                line = np.zeros(layout.box.nodes[lead + axis])
                line[: len(values)] = values[::-1]
                rate = rate + line[::-side].reshape([-1 if a == lead + axis else 1 for a in range(3)])
        rate[np.isin(layout.box.node_indices(), held)] = 0
        where = np.nonzero(rate)
        index = self.engine.all_components(layout.box.node_indices()[where])
        rate = np.tile(rate[where], self.engine.components)
        if self.model.order == 1:
            return index, np.ones_like(rate), np.ones_like(rate), rate
        share, total = self.model.damping * self.dt, (self.model.damping + rate) * self.dt
        return index, (1 - total) / (1 - share), (1 + share) / (1 + total), np.zeros_like(rate)

    def _near_indices(self) -> np.ndarray:
        """Places of the near field in a level, of all components."""
        return self.engine.all_components(self.engine.core.node_indices()[self._near])

    def leak(self) -> np.ndarray:
        """Rate at which each node loses its value to what surrounds the body; of the lattice's shape, empty without."""
        leaks = [leak for _, leak in self.conditions.leaks]
        return self.model.source_factor * sum(leaks[1:], leaks[0]) if leaks else np.zeros(0)
