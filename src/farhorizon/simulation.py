"""Simulation: puts lattice, model, boundaries, cracks and sources together, and runs them."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from farhorizon.analysis.chain import Recursion, half_weights
from farhorizon.analysis.choice import Choice
from farhorizon.analysis.flux import nodal_flux, power_across
from farhorizon.analysis.spectrum import band
from farhorizon.beyond import Beyond
from farhorizon.boundaries import (
    Absorbing,
    Boundary,
    Closing,
    Closure,
    Exact,
    ExactEnds,
    Fixed,
    Free,
    LatticePML,
    Outline,
    Periodic,
    PlaneWave,
    Sponge,
    sides,
)  # fmt: skip
from farhorizon.boundaries.plane_wave import SERIES, Medium
from farhorizon.certificate import BUDGET, Certificate, certify
from farhorizon.conditions import Conditions, Constraint, resolve
from farhorizon.constraints import Holds, Prescribed
from farhorizon.cracks import Crack, as_crack, cut_bonds
from farhorizon.describe import describe, rebuild
from farhorizon.engine import NEVER, Engine, Layer, available_threads
from farhorizon.engine.layout import Block
from farhorizon.errors import FileFormatError, InputError, UnstableError
from farhorizon.integrators import Euler, Verlet, stage_effects
from farhorizon.kernel import Kernel
from farhorizon.lattice import AXES, Lattice
from farhorizon.machine import available_memory
from farhorizon.models import Corrosion, ScalarModel
from farhorizon.report import Report
from farhorizon.results import read_checkpoint, write_checkpoint
from farhorizon.shapes import Cut, Shape
from farhorizon.sources import checked, parts, split, steady
from farhorizon.specimens import Specimen, place
from farhorizon.stencil import Stencil

_GUARD_STEPS = 200  # steps between two looks of the instability guard, at most; fewer on lattices above
_GUARD_NODES = 1_000_000  # this many nodes, so that an interrupt is heard within seconds
_EXPLODED = 1e6  # growth of the largest value over all that initial data and sources explain
_TABLE = 1 << 20  # numbers in one table of source amplitudes


class Simulation:
    """One run of a model on a lattice.

    Parameters
    ----------
    lattice : Lattice
        The near field.
    model : Wave, Diffusion, Heat, Corrosion or Beam
    boundary : Boundary or mapping
        One for all sides, or ``{"x-": ..., "x+": ..., "y": ..., "all": ...}``.
    initial : mapping
        "u" and, for waves, "v" (velocity): arrays of the lattice's shape, callables of the coordinates, expressions or numbers.
    sources : sequence
        `Source`, array, callable of the coordinates and t, or expression.
    cracks : sequence
        Cuts, points of polylines (2D), of polygons (3D) or positions (1D); `Crack` for one that conducts a little or opens later.
    constraints : sequence
        `Temperature`, `Flux`, `Insulated`, `Convection`: conditions on nodes of the body; `Prescribed`: nodes that follow a value for a while.
    specimens : sequence of Specimen
        The metal of a `Corrosion`; all else is liquid.
    balance : bool
        Record what flows into the near field, for `balance`.
    coefficient : array_like, optional
        Factor on bonds, given on the nodes.
    rule : {"both", "arithmetic", "harmonic"}
        How the coefficients of a bond's ends combine; "both" is the smaller one.
    rim : {"free", "fixed"}
        What the outline of a body is: bonds across it are absent, or the field is held at the background outside.
    background : float
        Uniform state of the infinite medium.
    dt : float, optional
        Time step; half the stable limit unless given.
    dtype : {"float64", "float32"}
    threads : int, optional
        All that the machine offers unless given; small lattices use one.

    Attributes
    ----------
    time : float
    step_count : int
    dt : float
    choices : dict of str to Choice
        The layers that were chosen by angle, by side.
    stop_requested : bool
        Set it (from a signal handler, an observer) to end `run` with KeyboardInterrupt between two steps.
    closure : Closure or None
        The conditions along the outline of the near field.
    start_u, start_v : ndarray
        Initial values less the background, and initial velocities.
    fields : dict of str to ndarray
        The near field, "u", and for waves "v" (half a step late, (u(n) - u(n-1))/dt); nan outside a window or body, and on
        the nodes beyond a wall that conditions set as images of those inside. Of a corrosion "solid", 1 in the metal and 0 in the liquid, and
        "dissolved", the time at which a node became liquid: 0 where it was from the start, nan in the metal.

    Raises
    ------
    InputError
        Anything that cannot be computed, before any work.
    """

    def __init__(
        self,
        lattice: Lattice,
        model: ScalarModel,
        boundary: Boundary | Mapping[str, Boundary] | None = None,
        initial: Mapping[str, Any] | None = None,
        sources: Sequence[Any] = (),
        cracks: Sequence[Any] = (),
        coefficient: Any = None,
        background: float = 0.0,
        observe: Sequence[Callable[[Simulation], None]] = (),
        dt: float | None = None,
        dtype: str = "float64",
        threads: int | None = None,
        rule: str = "both",
        rim: str = "free",
        constraints: Sequence[Constraint | Prescribed] = (),
        balance: bool = False,
        specimens: Sequence[Specimen] = (),
    ) -> None:
        self.lattice, self.model, self.background = lattice, model, float(background)
        self.observers = list(observe)
        self.sides = sides(LatticePML() if boundary is None else boundary, lattice.dim)
        self._check_model(cracks, coefficient, specimens)
        if dtype not in ("float64", "float32"):
            raise InputError("unknown number type", value=dtype, limit="float64, float32", key="dtype")
        if threads is not None and not 1 <= threads <= available_threads():
            raise InputError("so many threads are not to be had", value=threads, limit=f"1 to {available_threads()}", key="threads",
                             remedy="leave it out, or set NUMBA_NUM_THREADS before the program starts")  # fmt: skip
        if rim not in ("free", "fixed"):
            raise InputError("unknown rim of a body", value=rim, limit="free, fixed", key="rim")
        if rim == "fixed" and lattice.body is None:
            raise InputError("only a body has a rim", value=rim, key="rim", remedy="give the lattice a body, or fix the sides: Fixed(...)")
        self.rim = rim
        if not np.isfinite(self.background):
            raise InputError("the background must be finite", value=background, key="background")
        self.stencil = model.stencil(lattice.spacing, lattice.dim)
        self._check_closing()
        self._layers = self._make_layers()
        self._check_size()
        self._check_memory(dtype)
        factor = None if coefficient is None else checked(coefficient, lattice, "coefficient")
        if factor is not None and (factor < 0).any():
            raise InputError("a coefficient must not be negative", value=float(factor.min()), limit=">= 0", key="coefficient")
        self.strongest = model.strongest if factor is None else float(factor.max())
        self.varied = factor is not None and bool(np.ptp(factor) > 0)
        self.conditions = self._resolve(constraints, factor)
        self._hidden = self._hide()
        self.rate_limit = self.stencil.symbol_maximum * model.coefficient / lattice.spacing**2 * max(self.strongest, 1e-300)
        self.rate_limit += float(self.leak().max(initial=0))
        self.step_limit = model.integrator.step_limit(self.rate_limit)
        self.dt = self._choose_step(dt)
        self.choices: dict[str, Choice] = {}
        self._choose_layers(initial or {}, sources, dtype)
        self.time, self.step_count = 0.0, 0
        self.stop_requested = False
        self._guard_steps = max(1, min(_GUARD_STEPS, _GUARD_STEPS * _GUARD_NODES // max(int(np.prod(lattice.shape)), 1)))

        self._beyond = Beyond(lattice, self.sides, model.order, self._depth(), self._near_field)
        u = self._initial("u", initial or {})
        v = self._initial("v", initial or {}) if "v" in (initial or {}) and model.order == 2 else np.broadcast_to(0.0, lattice.shape)
        for name in set(initial or {}) - ({"u", "v"} if model.order == 2 else {"u"}):
            raise InputError("unknown initial field", value=name, limit="u, v" if model.order == 2 else "u", key="initial")
        self._holds = Holds(tuple(c for c in constraints if isinstance(c, Prescribed)), lattice, model.integrator, self.dt, self.background)
        u = self._holds.start(u)
        solid, metal = self._place(specimens)
        u = np.where(solid, metal - self.background, u) if solid.any() else u
        self.varied |= bool(solid.any())
        self.start_u, self.start_v, self._first_solid = u, v, int(solid.sum())
        self._cracks = [as_crack(c, lattice.dim) for c in cracks]
        cuts = [c.cut for c in self._cracks]
        self._beyond.check_cracks(cuts, self.stencil.reach)
        self._unsplit: list[Callable[..., Any]] = []
        self._source_peaks: dict[int, float] = {}
        self._looked = 0.0  # up to this time
        self.sources = [self._split_source(s, f"source[{i}]" if len(sources) > 1 else "source") for i, s in enumerate(sources)]
        self._drives = self.sources + [drive for _, drive in self.conditions.sources]
        self._balance = False
        self._margins = self._choose_margins(u, v, solid.astype(float) if solid.any() else factor, cuts)
        self._check_conditions()
        self._make_engine(factor, rule, dtype, threads)
        self._set_phases(np.where(solid, NEVER, 0))
        if solid.any():
            self._check_dry()
        self.closure = self._close(factor)
        self._cut(self._cracks)
        self._opened = len(self._cracks)
        self._open_cracks()
        self._first_cuts = self.engine.absent_bonds
        self._hold_and_damp()
        self._ends = self._make_ends(factor)
        held = [abs(b.value - self.background) for b in self.sides.values() if isinstance(b, Fixed)]
        self._setup: dict[str, Any] = {
            "lattice": lattice, "model": model, "boundary": {AXES[a] + "-+"[side > 0]: b for (a, side), b in self.sides.items()},
            "sources": list(sources), "cracks": self._cracks, "constraints": list(constraints), "balance": balance,
            "coefficient": factor, "background": self.background, "dt": self.dt, "specimens": list(specimens),
            "dtype": dtype, "threads": threads, "rule": rule, "rim": rim,
        }  # fmt: skip
        self._scale = max([float(np.abs(u).max()), float(np.abs(v).max()) * self.dt, 1e-300, *held])
        self._balance = balance
        self._start(u, v)
        if balance:
            self._open_books()

    # --- set-up ------------------------------------------------------------------------------------------------

    def _check_model(self, cracks: Sequence[Any], coefficient: Any, specimens: Sequence[Specimen]) -> None:
        """Sides, bonds and phases that the model does not have."""
        model = self.model
        for (axis, side), boundary in self.sides.items():
            if model.sides and type(boundary).__name__ not in model.sides:
                raise InputError(f"{type(model).__name__} has no such side", value=type(boundary).__name__, limit=", ".join(model.sides),
                                 key=f"boundary.{AXES[axis]}{'-+'[side > 0]}", remedy=model.sides[0])  # fmt: skip
        if not model.bonds and (len(cracks) or coefficient is not None or self.lattice.body is not None):
            key = "crack" if len(cracks) else "coefficient" if coefficient is not None else "lattice.body"
            raise InputError(f"the bonds of a {type(model).__name__} cannot be cut or weakened one by one", key=key, remedy="leave it out")
        if isinstance(model, Corrosion) and coefficient is not None:
            raise InputError("the phases are the coefficient of a Corrosion", key="coefficient", remedy="leave it out")
        if len(specimens) and not isinstance(model, Corrosion):
            raise InputError("only a Corrosion has specimens", value=type(model).__name__, key="specimens", remedy="Corrosion(...)")

    def _check_closing(self) -> None:
        """Conditions along an outline: integrators of one stage, windows closed by one condition all around."""
        closing = {key: b for key, b in self.sides.items() if isinstance(b, Closing)}
        self._near_field: np.ndarray | None = None  # nodes of a window that a condition closes along its outline
        if not closing:
            return
        name = type(next(iter(closing.values()))).__name__
        if not isinstance(self.model.integrator, Euler | Verlet):
            raise InputError(f"{name} goes along with one stage a step", value=self.model.integrator.name, key="model.integrator",
                             limit="forward Euler, velocity Verlet", remedy='integrator="euler", or LatticePML')  # fmt: skip
        if self.lattice.window is None:
            return
        if len(closing) < len(self.sides) or len({repr(b) for b in closing.values()}) > 1:
            raise InputError(f"{name} closes a window along its outline, all around", key="boundary", remedy="the same condition on all sides")
        self._near_field = self.lattice.mask

    def _close(self, factor: np.ndarray | None) -> Closure | None:
        """The conditions along the outline; None without."""
        closing = {key: b for key, b in self.sides.items() if isinstance(b, Closing)}
        if not closing:
            return None
        lattice, model, dx = self.lattice, self.model, self.lattice.spacing
        shape = self.engine.core.nodes[3 - lattice.dim :]
        near = np.zeros(shape, bool)
        inside = self._near[3 - lattice.dim :]
        near[inside] = True if self._near_field is None else self._near_field
        outline = Outline(
            self._origin, dx, near, lattice.window, closing, frozenset(a for (a, _), b in self.sides.items() if isinstance(b, Periodic)),
            frozenset(key for key, b in self.sides.items() if isinstance(b, Free)), self.stencil.offsets,
        )  # fmt: skip
        scale = 1.0 if factor is None else float(factor[0 if self._near_field is None else tuple(np.argwhere(self._near_field)[0])].flat[0])
        kernel = model.operator if isinstance(model.operator, Kernel) else None
        medium = Medium(
            model.order, model.coefficient * scale, self.dt, model.damping, dx * self.stencil.offsets,
            self.stencil.weights * model.coefficient * scale / dx**2, 0.0 if kernel is None else kernel.horizon,
            () if kernel is None else tuple(kernel.series(lattice.dim, SERIES)),
        )  # fmt: skip
        closure = Closure(outline, medium)
        indices = self.engine.core.node_indices().reshape(shape)
        closure.attach(self.engine, indices)
        self._check_fringe(closure, factor)
        return closure

    def _check_fringe(self, closure: Closure, factor: np.ndarray | None) -> None:
        """What a condition along the outline reads is the homogeneous medium: no other material, no body's end, no constraint."""
        lattice = self.lattice
        material = np.ones(lattice.shape) if factor is None else factor.copy()
        if lattice.body is not None and lattice.mask is not None:
            material[~lattice.mask] = np.nan
        solid = self._solid if isinstance(self.model, Corrosion) else np.zeros(0)
        for nodes in (*self._holds.nodes, self.conditions.nodes, np.flatnonzero(self.leak()), np.flatnonzero(solid)):
            material.flat[nodes] = np.nan
        pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(lattice.dim)]
        read = np.pad(material, pads, mode="edge")[tuple(closure.fringe.index.T)]
        if not np.ptp(read) == 0:
            raise InputError("a condition along the outline reads metal, or nodes where the material varies, the body ends or a constraint holds",
                             key="boundary", limit=f"uniform within {closure.fringe.depth:g} of the outline",
                             remedy="enlarge the near field, or use a LatticePML")  # fmt: skip

    def _check_size(self) -> None:
        for axis, (n, m) in enumerate(zip(self.lattice.shape, self.stencil.reach, strict=True)):
            if n < 2 * m + 1:
                raise InputError(
                    "the near field is thinner than the stencil", value=f"{n} nodes along {AXES[axis]}", limit=f">= {2 * m + 1}",
                    key="lattice", remedy="enlarge the lattice or refine it",
                )  # fmt: skip

    def _check_memory(self, dtype: str) -> None:
        need = self._memory_needed(np.dtype(dtype).itemsize)
        if need > available_memory():
            raise InputError("the run does not fit into memory", value=f"about {need / 2**30:.3g} GiB for {int(np.prod(self.lattice.shape))} nodes",
                             limit=f"{available_memory() / 2**30:.3g} GiB available", key="lattice",
                             remedy="a coarser or smaller lattice, thinner layers, or float32")  # fmt: skip

    def _memory_needed(self, itemsize: int) -> float:
        """Bytes at the peak, in setting up: three levels and the layers' memory once more, and about seven fields besides coordinates."""
        reach = self.stencil.reach
        more = {key: self._width(key) for key, b in self.sides.items() if isinstance(b, Sponge | Closing)}
        shape = [n + sum(width for (a, _), width in more.items() if a == axis) for axis, n in enumerate(self.lattice.shape)]
        columns = [sum(layer.columns for (a, _), layer in self._layers.items() if a == axis) for axis in range(self.lattice.dim)]
        nodes = [float(n + 2 * m + c) for n, m, c in zip(shape, reach, columns, strict=True)]
        slots = [float(n + 2 * m + c * (2 * m + 1)) for n, m, c in zip(shape, reach, columns, strict=True)]
        tree = max(c * (2 * m + 1) / (2 if c else 1) * np.prod(slots) / s for c, m, s in zip(columns, reach, slots, strict=True))
        memory = sum(2 * m * c * np.prod(slots[:a]) * np.prod(nodes[a + 1 :]) for a, (c, m) in enumerate(zip(columns, reach, strict=True)))
        levels = self.model.integrator.stages(1.0, 0.0, self.lattice.dim == 1).levels
        return float(itemsize * ((levels + 3) * np.prod(nodes) + tree + 2 * memory) + 8 * (self.lattice.dim + 7) * np.prod(self.lattice.shape))

    def _choose_step(self, dt: float | None) -> float:
        if dt is None:
            fitted = [b.step_limit(self.model, self.lattice.spacing, self.lattice.dim) for b in self.sides.values() if isinstance(b, PlaneWave)]
            return 0.5 * min([self.step_limit, *fitted])
        if not (np.isfinite(dt) and 0 < dt):
            raise InputError("the time step must be positive", value=dt, key="run.dt")
        if dt > self.step_limit * (1 + 1e-12):
            raise InputError("the time step is above the stable limit", value=dt, limit=f"{self.step_limit:.6g}", key="run.dt",
                             remedy=f"dt <= {0.9 * self.step_limit:.4g}, or leave dt out")  # fmt: skip
        return float(dt)

    def _initial(self, name: str, initial: Mapping[str, Any]) -> np.ndarray:
        """Initial values less the background; refuses data that the infinite medium would have beyond the near field."""
        level = self.background if name == "u" else 0.0
        value, key = initial.get(name, level), f"initial.{name}"
        given = checked(value(*self.lattice.coordinates()) if callable(value) else value, self.lattice, key) - level
        values = self._inside(given)
        if np.ndim(value):
            self._beyond.check_values(given if self._near_field is not None else values, key)
        elif name in initial:
            function = value if callable(value) else lambda *_: value
            self._beyond.check_function(function, float(np.abs(values).max(initial=0)), key, level, "initial value")
        return values

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
        """The solid nodes and what they hold; refuses metal at and beyond an absorbing side, where all must be liquid."""
        if not isinstance(self.model, Corrosion):
            return np.zeros(self.lattice.shape, bool), np.zeros(self.lattice.shape)
        solid, metal = place(specimens, self.lattice, self.model.saturation, self.background)
        for (axis, side), boundary in self.sides.items():
            if isinstance(boundary, Absorbing) and np.take(solid, 0 if side < 0 else -1, axis).any():
                raise InputError(f"a specimen touches the absorbing side {AXES[axis]}{'-+'[side > 0]}; beyond it all is liquid", key="specimens",
                                 remedy="enlarge the near field, or end the specimen at a Free side")  # fmt: skip
        for number, specimen in enumerate(specimens):
            if isinstance(specimen.where, Shape):
                shape = specimen.where
                self._beyond.check_function(lambda *at, shape=shape: shape.contains(np.stack(at, -1)), 1.0, f"specimen[{number}]")
        return solid, metal

    def _set_phases(self, dissolved: np.ndarray) -> None:
        """Give the engine the step at which each node of the near field became liquid (`NEVER`: solid), for a corrosion."""
        if isinstance(self.model, Corrosion):
            core = np.zeros(self.engine.core.nodes, np.int64)
            core[self._near] = dissolved.reshape(core[self._near].shape)
            self.engine.set_phases(core, self.model.interface, self.model.saturation - self.background)

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
            raise InputError("a source or a condition acts on solid nodes", value=f"{int((busy & self._solid).sum())} nodes", key="specimens",
                             remedy="keep sources and conditions in the liquid")  # fmt: skip

    @property
    def _solid(self) -> np.ndarray:
        """The nodes of the near field that are solid now, in a corrosion."""
        return (self.engine.dissolved[self._near] == NEVER).reshape(self.lattice.shape)

    def _check_conditions(self) -> None:
        """The layer beyond an absorbing side continues the medium, not a condition on its nodes."""
        leak = self.leak()
        if not self.conditions.nodes.size and not leak.any():
            return
        busy = np.zeros(self.lattice.shape, bool)
        busy.ravel()[self.conditions.nodes] = True
        if leak.size:
            busy |= leak > 0
        for (axis, side), boundary in self.sides.items():
            m = self.stencil.reach[axis] - self._margins[axis, side] + 1
            if isinstance(boundary, LatticePML | Sponge) and m > 0:
                last = np.arange(m) if side < 0 else self.lattice.shape[axis] - 1 - np.arange(m)
                if np.take(busy, last, axis).any():
                    raise InputError(
                        f"a condition holds on nodes within one reach of the absorbing side {AXES[axis]}{'-+'[side > 0]}", key="constraints",
                        limit=f"none on the last {m} nodes", remedy="a Free side there, or restrict the condition by `within`",
                    )  # fmt: skip

    def _split_source(self, source: Any, key: str) -> tuple[np.ndarray | None, Callable[..., Any]]:
        """A source as a function of space times one of time if it splits; refuses what the near field would miss."""
        space, time = parts(source)
        found = split(source, self.lattice)
        values = found[0]
        inside = self._near_field
        if space is None or values is None:
            self._unsplit.append(time)
        elif np.ndim(space):
            self._beyond.check_values(values, key)
        else:
            function = space if callable(space) else lambda *_: space
            peak = float(np.abs(values if inside is None else values[inside]).max(initial=0))
            self._beyond.check_function(function, peak, key, missed="source value")
        return found

    def check_sources(self, until: float) -> None:
        """Look beyond the absorbing sides at sources that do not split into space and time, at up to 64 even times; `run` calls it.

        Parameters
        ----------
        until : float
            End of the run. What was looked at before is not looked at again.

        Raises
        ------
        InputError
            The near field would miss more of a source than the side's target.
        """
        if self._unsplit and until > self._looked:
            times = np.linspace(self._looked, until, min(64, int(np.ceil((until - self._looked) / self.dt))) + 1)
            for number, source in enumerate(self._unsplit):
                self._source_peaks[number] = self._beyond.check_moving(source, times, self._source_peaks.get(number, 0.0))
            self._looked = until

    def prepare(self, until: float) -> int:
        """What `run` does first: `check_sources`, and kernels of exact ends that last to the end of the run; returns the number of the last step.

        Raises
        ------
        InputError
            As `check_sources`; a kernel that does not fit into memory.
        """
        self.check_sources(until)
        last = int(np.ceil(until / self.dt - 1e-9))
        if self._ends is not None:
            self._ends.cover(last)
        return last

    def _inside(self, values: np.ndarray) -> np.ndarray:
        """Zero outside a body, where there are no nodes, and beyond a window's outline if a condition closes it."""
        if self._near_field is not None:
            return np.where(self._near_field, values, 0.0)
        return np.where(self.lattice.mask, values, 0.0) if self.lattice.body is not None and self.lattice.mask is not None else values

    def _make_layers(self) -> dict[tuple[int, int], Layer]:
        """The stretch of each layer that follows from the target alone or is given, by (axis, side)."""
        lattice, model = self.lattice, self.model
        half_width = max(float((lattice.upper - lattice.lower).max()) / 2, lattice.spacing)
        return {
            (axis, side): boundary.layer(model.order, model.coefficient, lattice.spacing, self.stencil.reach[axis], half_width, lattice.dim)
            for (axis, side), boundary in self.sides.items()
            if isinstance(boundary, LatticePML) and boundary.angle is None
        }

    def _choose_layers(self, initial: Mapping[str, Any], sources: Sequence[Any], dtype: str) -> None:
        """Add the layers that are chosen by angle, which takes the step and the waves of the data; one choice for sides that are alike."""
        known: dict[Any, tuple[Layer, Choice]] = {}
        for (axis, side), boundary in self.sides.items():
            if isinstance(boundary, LatticePML) and boundary.angle is not None:
                name, stencil = AXES[axis] + "-+"[side > 0], self.stencil.along(axis)
                like = boundary, stencil.offsets.tobytes(), stencil.weights.tobytes()
                if like not in known:
                    known[like] = self._chosen(boundary, stencil, name, initial, sources)
                self._layers[axis, side], self.choices[name] = known[like]
        if known:
            self._check_memory(dtype)

    def _chosen(
        self, boundary: LatticePML, stencil: Stencil, name: str, initial: Mapping[str, Any], sources: Sequence[Any]
    ) -> tuple[Layer, Choice]:  # fmt: skip
        """A layer chosen for the waves of the data, unless the boundary names them."""
        if self.model.order != 2:
            raise InputError("only for waves a layer is chosen by angle", value=boundary.angle, key=f"boundary.{name}.angle", remedy="leave it out")
        waves = (0.0, 0.0) if boundary.wavelengths else self._data_band(initial, sources, f"boundary.{name}.wavelengths")
        recursion = Recursion.of(self.model.integrator, self.dt, self.model.damping)
        return boundary.chosen(stencil, self.model.coefficient, self.lattice.spacing, recursion, self.dt, waves)

    def _data_band(self, initial: Mapping[str, Any], sources: Sequence[Any], key: str) -> tuple[float, float]:
        """Shortest and longest wave of initial data and sources."""
        fields = [np.zeros(self.lattice.shape)] * 2
        for number, name in enumerate(("u", "v")):
            value = initial.get(name, 0.0)
            fields[number] = checked(value(*self.lattice.coordinates()) if callable(value) else value, self.lattice, f"initial.{name}")
        fields[0] = fields[0] - (self.background if "u" in initial else 0.0)
        found = [split(s, self.lattice)[0] for s in sources]
        spaces = [f for f in found if f is not None]
        waves = band([*fields, *spaces], self.lattice.spacing, [1, 0] + [0] * len(spaces)) if len(spaces) == len(found) else None
        if waves is None:
            raise InputError("the wavelengths cannot be read from data and sources", key=key, remedy="give wavelengths = [shortest, longest]",
                             limit="initial data, or sources that split into space and time")  # fmt: skip
        return waves.shortest, waves.longest

    def _depth(self) -> dict[tuple[int, int], int]:
        """Nodes beyond each absorbing side at which data and sources are looked at: its layer or sponge, or one reach if that is more.

        Beyond an exact end, where there is no layer, as many as the near field has.
        """
        nodes = {key: layer.columns for key, layer in self._layers.items()}
        nodes |= {key: self.lattice.shape[key[0]] for key, b in self.sides.items() if isinstance(b, Exact)}
        nodes |= {key: self._width(key) for key, b in self.sides.items() if isinstance(b, Sponge | Closing)}
        return {key: max(n, self.stencil.reach[key[0]]) for key, n in nodes.items()}

    def _width(self, key: tuple[int, int]) -> int:
        """Nodes of the core beyond the near field that a sponge, or a condition along the outline, takes."""
        boundary = self.sides[key]
        if isinstance(boundary, Sponge):
            return boundary.nodes
        thick = boundary.layer if isinstance(boundary, PlaneWave) else None
        return self.stencil.reach[key[0]] if thick is None else int(thick / self.lattice.spacing + 1e-9)

    def _choose_margins(self, u: np.ndarray, v: np.ndarray, factor: np.ndarray | None, cuts: Sequence[Cut]) -> dict[tuple[int, int], int]:
        """Nodes of the core beyond the near field: a sponge, or unstretched nodes in front of a layer.

        A layer's entrance must be free of sources, data, cracks and changes of the material. One node keeps sources
        out; the others need as many more as the stencil reaches. An exact end must be free of cracks and changes of the material.
        """
        margins = {}
        for (axis, side), boundary in self.sides.items():
            if isinstance(boundary, Sponge | Closing):
                margins[axis, side] = self._width((axis, side))
            elif isinstance(boundary, LatticePML | Exact):
                m = self.stencil.reach[axis]
                last = np.arange(m + 1) if side < 0 else self.lattice.shape[axis] - 1 - np.arange(m + 1)
                least = int(isinstance(boundary, LatticePML))
                faint = 1e-3 * boundary.wanted(self.model.order)
                busy = bool(least) and any(np.abs(np.take(f, last, axis)).max() > faint * np.abs(f).max() for f in (u, v))
                busy |= factor is not None and bool(np.ptp(np.take(factor, last, axis), axis=axis).any())
                edge = (self.lattice.lower if side < 0 else self.lattice.upper)[axis]
                near = [side * (edge - cut.bounds()[(side + 1) // 2][axis]) < (m + 1) * self.lattice.spacing for cut in cuts]
                margins[axis, side] = 1 + m if busy or any(near) else least
            else:
                margins[axis, side] = 0
        return margins

    def _make_engine(self, factor: np.ndarray | None, rule: str, dtype: str, threads: int | None) -> None:
        lattice, model = self.lattice, self.model
        lead = 3 - lattice.dim
        core = (1,) * lead + tuple(n + self._margins[a, -1] + self._margins[a, 1] for a, n in enumerate(lattice.shape))
        offsets = np.zeros((len(self.stencil.weights), 3), int)
        offsets[:, lead:] = self.stencil.offsets
        if rule not in ("both", "arithmetic", "harmonic"):
            raise InputError("unknown bond rule", value=rule, limit="both, arithmetic, harmonic", key="rule")
        layers = {(lead + axis, side): layer for (axis, side), layer in self._layers.items()}
        periodic = frozenset(lead + a for (a, side), b in self.sides.items() if side < 0 and isinstance(b, Periodic))
        stages = model.integrator.stages(self.dt, model.damping, lattice.dim == 1)
        grown = None
        if factor is not None:
            pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(lattice.dim)]
            grown = np.pad(factor, pads, mode="edge").reshape(core)
            self._check_material(grown, lead)
        self.engine = Engine(
            core, offsets, self.stencil.weights * model.coefficient / lattice.spacing**2, stages, self.dt, layers=layers, periodic=periodic,
            real=dtype, threads=threads or available_threads(), coefficient=grown, rule=rule,
        )  # fmt: skip
        self._near = tuple([slice(None)] * lead + [slice(self._margins[a, -1], self._margins[a, -1] + n) for a, n in enumerate(lattice.shape)])
        self._origin = lattice.lower - lattice.spacing * np.array([self._margins[a, -1] for a in range(lattice.dim)])
        for (axis, side), boundary in self.sides.items():
            if isinstance(boundary, Fixed) and boundary.value != self.background:
                self._fix(lead + axis, side, boundary.value - self.background)

    def _make_ends(self, factor: np.ndarray | None) -> ExactEnds | None:
        """The exact ends, whose chains have the bonds of the last nodes; None without."""
        found = [(side, b) for (_, side), b in self.sides.items() if isinstance(b, Exact)]
        if not found:
            return None
        if factor is not None and any(factor[0 if side < 0 else -1] == 0 for side, _ in found):
            raise InputError("the medium beyond an exact end needs bonds", value=0.0, limit="positive at the end", key="coefficient", remedy="Free")
        recursion = Recursion.of(self.model.integrator, self.dt, self.model.damping)
        bonds = half_weights(self.stencil, self.model.coefficient / self.lattice.spacing**2)
        line = self.engine.core.node_indices().ravel()
        return ExactEnds(
            self.engine, ["x-" if side < 0 else "x+" for side, _ in found], [b for _, b in found],
            [bonds * (1.0 if factor is None else factor[0 if side < 0 else -1]) for side, _ in found], recursion,
            np.array([line[0] + np.arange(bonds.size) if side < 0 else line[-1] - np.arange(bonds.size) for side, _ in found]),
        )  # fmt: skip

    def _check_material(self, core: np.ndarray, lead: int) -> None:
        """A layer, and an exact end, continue the material along the normal: it must not vary there within one reach."""
        for (axis, side), boundary in self.sides.items():
            if isinstance(boundary, LatticePML | Exact):
                n, m = core.shape[lead + axis], self.stencil.reach[axis]
                last = np.take(core, np.arange(m + 1) if side < 0 else np.arange(n - m - 1, n), lead + axis)
                if np.any(np.ptp(last, axis=lead + axis) > 0):
                    raise InputError(
                        f"the material varies along {AXES[axis]} within one reach of an absorbing side", key="coefficient",
                        limit=f"constant over the last {m + 1 - self._margins[axis, side]} nodes", remedy="enlarge the near field",
                    )  # fmt: skip

    def _fix(self, axis: int, side: int, value: float) -> None:
        """Set the halo of a side, in every level, to a value above the background."""
        if any(isinstance(b, LatticePML) for (a, _), b in self.sides.items() if a != axis - (3 - self.lattice.dim)):
            raise InputError(
                "a Fixed value beside a LatticePML must equal the background: the layer would have to absorb a state that never decays",
                value=value + self.background, limit=self.background, key="boundary", remedy="set background, or use Periodic or Free",
            )  # fmt: skip
        block = self.engine.core
        m = block.reach[axis]
        strip = tuple((slice(0, m) if side < 0 else slice(-m, None)) if a == axis else slice(None) for a in range(3))
        for level in self.engine.levels[: 3 - self.engine.stages.increments]:
            block.plane.all(level)[strip] = value

    def _open_cracks(self) -> None:
        """Cut what has opened by now."""
        due = [crack for crack in self._cracks if crack.opens <= self.time + 1e-9 * self.dt]
        if len(due) != self._opened:
            self._cut(due)
            self._opened = len(due)
            if self._balance and self.step_count:
                self._open_books()

    def _until_opening(self) -> int:
        """Steps until the next crack opens; very many without."""
        waits = [int(np.ceil(c.opens / self.dt - 1e-9)) - self.step_count for c in self._cracks]
        return min((w for w in waits if w > 0), default=sys.maxsize)

    def _cut(self, cracks: Sequence[Crack]) -> None:
        """Absent bonds: cut by cracks, across a free side, or to nodes outside a body."""
        engine, lead = self.engine, 3 - self.lattice.dim
        block = engine.core
        offsets = engine.offsets
        found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        shape = block.nodes[lead:]
        for crack in cracks:
            cut, lost = crack.cut, 1 - crack.factor
            crossed = self._crossed(cut)
            nodes, bonds = cut_bonds(cut, self._origin, self.lattice.spacing, shape, self.stencil.offsets)
            flat = block.plane.origin + nodes @ np.array(block.stride[lead:])
            found.append((flat, flat + offsets[bonds] @ np.array(block.stride), lost * engine.weights[bonds]))
            if self.closure is not None and np.isin(flat, self.closure.nodes).any():
                raise InputError("a crack cuts bonds of nodes that a condition along the outline reads", key="crack",
                                 value=[b.tolist() for b in cut.bounds()], remedy="enlarge the near field, or use a LatticePML")  # fmt: skip
            for axis, side in crossed:
                *ends, weights = self._continue_crack(cut, nodes, bonds, axis, side)
                found.append((ends[0], ends[1], lost * weights))
        if any(isinstance(b, Free) for b in self.sides.values()) or (self.lattice.body is not None and self.rim == "free"):
            exists = self._existing(self.rim == "free")
            for part in engine.layout.blocks.values():
                found += self._absent(part, exists)
        if self.closure is not None:
            found += self._beyond_halo(self.closure)
        if not found:
            engine.set_cuts(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
            return
        nodes, neighbours, weights = (np.concatenate([f[i] for f in found]) for i in range(3))
        order = np.argsort(-np.abs(weights), kind="stable")  # of two cracks across a bond the one that takes more counts
        nodes, neighbours, weights = nodes[order], neighbours[order], weights[order]
        _, first = np.unique(nodes * engine.layout.places + neighbours, return_index=True)
        engine.set_cuts(nodes[first], neighbours[first], weights[first])

    def _beyond_halo(self, closure: Closure) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Bonds of the near field beyond a halo that is thinner than the stencil reaches."""
        engine, block = self.engine, self.engine.core
        lead = 3 - self.lattice.dim
        exists = engine.spread(np.reshape(~closure.outside, block.nodes), {(lead + a, side): 0.0 for a, side in closure.outline.sides}) > 0.5
        near = block.node_indices().reshape(closure.halo.shape)[closure.outline.near]
        rows = []
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            other = near + int(offset @ np.array(block.stride))
            lost = ~exists[other]
            rows.append((near[lost], other[lost], np.full(int(lost.sum()), weight)))
        return rows

    def _crossed(self, cut: Cut) -> list[tuple[int, int]]:
        """Sides (axis, side) with a layer that a crack runs into; InputError where it crosses a sponge or a periodic side."""
        crossed = []
        for (axis, side), boundary in self.sides.items():
            edge, end = ((self.lattice.lower, self.lattice.upper)[(side + 1) // 2][axis], cut.bounds()[(side + 1) // 2][axis])
            if side * (end - edge) > 1e-9 * self.lattice.spacing and not isinstance(boundary, Free | Fixed):
                if not isinstance(boundary, LatticePML):
                    raise InputError("a crack crosses a side that cannot continue it", value=AXES[axis] + "-+"[side > 0], key="crack",
                                     remedy="shorten it, or use a LatticePML there")  # fmt: skip
                crossed.append((axis, side))
        return crossed

    def _continue_crack(self, cut: Cut, nodes: np.ndarray, bonds: np.ndarray, axis: int, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bonds that a crack parallel to a layer's normal cuts inside the layer, from those at the core's last nodes."""
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
        layer = self.engine.layout.blocks[tuple(side if a == lead + axis else 0 for a in range(3))]
        table = np.array(sorted(found[0]), int).reshape(-1, self.lattice.dim + 1)
        at = table[:, :-1].T
        normal = np.arange(layer.nodes[lead + axis])[:, None]
        index: tuple[Any, ...] = (*[0] * lead, *(normal if a == axis else at[a] for a in range(self.lattice.dim)))
        flat = layer.node_indices()[index]
        other = layer.slot_indices()[index] + self.engine.offsets[table[:, -1]] @ np.array(layer.stride)
        return flat.ravel(), other.ravel(), np.broadcast_to(self.engine.weights[table[:, -1]], flat.shape).ravel()

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
        note = f"the crack that runs into the layer at {AXES[axis]}{'-+'[side > 0]} is taken to go on straight without end"
        if note not in self._beyond.notes:
            self._beyond.notes.append(note)

    def _oblique(self, cut: Cut, axis: int, side: int) -> InputError:
        return InputError(
            f"a crack may run across the absorbing side {AXES[axis]}{'-+'[side > 0]} only straight along its normal, and beyond its first nodes",
            key="crack", value=[b.tolist() for b in cut.bounds()], limit=f"{self.lattice.lower.tolist()} to {self.lattice.upper.tolist()}",
            remedy="end it inside, turn it, or enlarge the near field",
        )  # fmt: skip

    def _existing(self, body: bool) -> np.ndarray:
        """True where a node of the medium is, False beyond free sides and, if wanted, outside the body; over a level and the slots."""
        lead = 3 - self.lattice.dim
        core = np.ones(self.engine.core.nodes)
        if body and self.lattice.body is not None and self.lattice.mask is not None:
            pads = [(self._margins[a, -1], self._margins[a, 1]) for a in range(self.lattice.dim)]
            core = np.pad(self.lattice.mask.astype(float), pads, mode="edge").reshape(core.shape)
            self._check_material(core, lead)
        beyond = {(lead + a, side): 0.0 for (a, side), b in self.sides.items() if isinstance(b, Free)}
        return self.engine.spread(core, beyond) > 0.5

    def _absent(self, block: Block, exists: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        if block.slots.all(exists).all():
            return []
        flat, slots = block.node_indices(), block.slot_indices()
        here = exists[slots]
        rows = []
        for offset, weight in zip(self.engine.offsets, self.engine.weights, strict=True):
            other = slots + int(offset @ np.array(block.stride))
            cut = here != exists[other]
            rows.append((flat[cut], other[cut], np.full(int(cut.sum()), weight)))
        return rows

    def _hold_and_damp(self) -> None:
        """Nodal factors: damping of the sponges, in the core and in the layers along it; nodes outside a fixed rim never move."""
        tables = []
        if any(isinstance(b, Sponge) for b in self.sides.values()):
            tables.append(self._damped())
        self._held = np.zeros(0, np.int64)
        if self.rim == "fixed":
            exists = self._existing(True)
            self._held = np.concatenate([b.node_indices()[~exists[b.slot_indices()]] for b in self.engine.layout.blocks.values()])
            tables.append((self._held, *np.zeros((3, len(self._held)))))
        leak = self.leak().ravel()
        lossy = np.flatnonzero(leak)
        if lossy.size:
            tables.append((self._near_indices()[lossy], *np.ones((2, lossy.size)), leak[lossy]))
        if tables:
            self.engine.set_damping(*(np.concatenate(columns) for columns in zip(*tables, strict=True)))

    def _damped(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Nodes of the sponges, and their factors on the old and on the new increment and their loss rate."""
        lead = 3 - self.lattice.dim
        nodes, rates = [], []
        for block in self.engine.layout.blocks.values():
            rate = np.zeros(block.nodes)
            for (axis, side), boundary in self.sides.items():
                if isinstance(boundary, Sponge) and block.segment[lead + axis] == 0:
                    values = boundary.damping(self.model.order, self.model.coefficient, self.lattice.spacing)
                    line = np.zeros(block.nodes[lead + axis])
                    line[: len(values)] = values[::-1]
                    rate = rate + (line if side < 0 else line[::-1]).reshape([-1 if a == lead + axis else 1 for a in range(3)])
            where = np.nonzero(rate)
            nodes.append(block.node_indices()[where])
            rates.append(rate[where])
        rate = np.concatenate(rates)
        index = np.concatenate(nodes)
        if self.model.order == 1:
            return index, np.ones_like(rate), np.ones_like(rate), rate
        share, total = self.model.damping * self.dt, (self.model.damping + rate) * self.dt
        return index, (1 - total) / (1 - share), (1 + share) / (1 + total), np.zeros_like(rate)

    def _start(self, u: np.ndarray, v: np.ndarray) -> None:
        engine = self.engine
        for level in engine.levels[: 1 if self.model.order == 2 else None]:  # all, for the sweep leaves out metal that nothing reaches
            engine.core.view(level)[self._near] = u.reshape(engine.core.view(level)[self._near].shape)
        near = self._near_indices()
        self._source_nodes = near if self._drives else np.zeros(0, np.int64)
        table = self.conditions
        engine.set_tied(near[table.nodes], table.starts, near[table.references], table.weights)
        if table.nodes.size:
            fields, amplitudes = self._tables(table.drives, table.nodes.shape, (0.0,), np.ones((1, 1)), 1)
            self._scale = max(self._scale, float(np.abs(fields).max(initial=0) * np.abs(amplitudes).max(initial=0)))
            engine.tie(amplitudes[0, 0] @ fields)
        self._hold()
        self._step_back(v)
        if self.closure is not None:
            self.closure.start()

    def _step_back(self, v: np.ndarray) -> None:
        """The level one step before the start, for equations of second order."""
        engine = self.engine
        if self.model.order == 1:
            return
        acceleration = self._acceleration()
        change = -(self.dt**2) / 2 * acceleration
        rate = engine.core.view(change)[self._near]
        rate += (self.dt * (1 + self.model.damping * self.dt) * v).reshape(rate.shape)
        change[self._held] = 0
        if self.closure is not None:
            change[self.closure.unmoved] = 0  # the medium beyond the outline is at rest
        if engine.stages.increments:
            engine.levels[2][:] = change
        for block in engine.layout.blocks.values():
            block.view(engine.levels[1])[...] = block.view(engine.levels[0]) - block.view(change)
        engine.memory[:] = 0  # the layers are at rest one step before the start
        engine.fill(engine.levels[1], advance=True)

    def _acceleration(self) -> np.ndarray:
        """What the medium, what lies beyond exact ends and the sources do to the present state, as a level."""
        acceleration = self.engine.apply(self.engine.current)
        if self._ends is not None:
            acceleration[self._ends.nodes] += self._ends.forces()
        near = self.engine.core.view(acceleration)[self._near]
        near += self._source_now(self.time).reshape(near.shape)
        return acceleration

    def _hold(self) -> None:
        """Tell the engine which nodes are held from now on."""
        self.engine.hold(self._near_indices()[self._holds.held(self.step_count)])

    def _release(self) -> None:
        """Let nodes go whose constraint ends now: the next step is their first, as the start is of all."""
        engine = self.engine
        for nodes, rate in self._holds.released(self.step_count) if self.model.order == 2 else ():
            at = self._near_indices()[nodes]
            change = self.dt * (1 + self.model.damping * self.dt) * rate - self.dt**2 / 2 * self._acceleration()[at]
            engine.older[at] = engine.current[at] - change
            if engine.stages.increments:
                engine.levels[2][at] = change
        self._hold()

    def _near_indices(self) -> np.ndarray:
        return np.ascontiguousarray(self.engine.core.node_indices()[self._near].ravel())

    # --- running -----------------------------------------------------------------------------------------------

    def _source_now(self, t: float) -> np.ndarray:
        total = np.zeros(self.lattice.shape)
        for space, time in self._drives:
            total += time(t) if space is None else space * time(t)
        return total * self.model.source_factor

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps; the compiled loop runs them without returning to Python.

        Raises
        ------
        UnstableError
            The field became non-finite or exploded.
        """
        done = 0
        while done < count:
            self._open_cracks()
            steps = min(count - done, self._guard_steps, self._until_opening())
            if self._holds.constraints:
                steps = self._holds.allow(self.step_count, steps)
            if self._ends is not None:
                steps = self._ends.allow(steps)
            self._advance(steps)
            if self._holds.constraints:
                self._release()
            done += steps
            self._guard()

    def _advance(self, steps: int) -> None:
        engine = self.engine
        dtype, stages, held = engine.dtype, len(engine.stages.numbers), self.conditions
        if not self._drives and not held.nodes.size:
            engine.advance(steps, np.zeros(0, np.int64), np.zeros((0, 0), dtype), np.zeros((steps, stages, 0), dtype), self._prescribed(steps))
            self._tick(steps)
            return
        samples, weights = self.model.integrator.source_samples(self.dt)
        tied_samples, held_weights = self.model.integrator.tied_samples(self.dt)
        weights = weights * self.model.source_factor
        drives = self._drives + held.drives
        general = any(space is None for space, _ in drives)
        batch = 1 if general else max(1, min(steps, _TABLE // max(stages * len(drives), 1)))
        done = 0
        while done < steps:
            n = min(batch, steps - done)
            strength, amplitudes = self._tables(self._drives, self.lattice.shape, samples, weights, n)
            if general and isinstance(self.model, Corrosion):
                self._refuse_wet(np.any(strength != 0, axis=0).reshape(self.lattice.shape))
            values, times = self._tables(held.drives, held.nodes.shape, tied_samples, held_weights, n)
            used = np.any(strength, axis=0)
            engine.advance(n, self._source_nodes[used] if self._drives else self._source_nodes, np.ascontiguousarray(strength[:, used], dtype),
                           amplitudes.astype(dtype), self._prescribed(n), values.astype(dtype), times.astype(dtype))  # fmt: skip
            if self._balance:
                self._book_sources(strength, amplitudes)
            explained = float(np.abs(strength).max(initial=0) * np.abs(amplitudes).max(initial=0)) * n * self.dt
            self._scale += explained * (max(1.0, self.time) if self.model.order == 2 else 1.0)
            self._scale = max(self._scale, float(np.abs(values).max(initial=0) * np.abs(times).max(initial=0)))
            self._tick(n)
            done += n

    def _prescribed(self, steps: int) -> np.ndarray | None:
        """Values of the held nodes after each of the next steps."""
        if not self._holds.constraints:
            return None
        values = self._holds.table(self.step_count, steps)
        self._scale = max(self._scale, float(np.abs(values).max(initial=0)))
        return values

    def _tables(
        self,
        drives: Sequence[tuple[np.ndarray | None, Callable[..., Any]]],
        shape: tuple[int, ...],
        samples: Sequence[float],
        weights: np.ndarray,
        count: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fields over nodes, shape (j, nodes), and their amplitudes in each stage of the next `count` steps, shape (count, stages, j).

        What does not split into space and time takes one field for each sample time of the next step.
        """
        times = self.dt * (self.step_count + np.arange(count))
        fields, table = [], []
        for space, time in drives:
            if space is None:
                fields += [np.broadcast_to(np.asarray(time(times[0] + s), float), shape).ravel() for s in samples]
                table += [np.broadcast_to(weights[:, i], (1, len(weights))) for i in range(len(samples))]
            else:
                fields.append(np.asarray(space, float).ravel())
                if time is steady:
                    table.append(np.broadcast_to(weights.sum(1), (count, len(weights))))
                else:
                    table.append(np.array([[time(t + s) for s in samples] for t in times], float) @ weights.T)
        if not fields:
            return np.zeros((0, int(np.prod(shape)))), np.zeros((count, len(weights), 0))
        amplitudes = np.stack(table, axis=-1)
        if not np.isfinite(amplitudes).all():
            raise InputError("a source or condition is not finite", value=f"t = {times[0]:g}", key="source")
        return np.stack(fields), amplitudes

    def _tick(self, steps: int) -> None:
        self.step_count += steps
        self.time = self.step_count * self.dt

    def _guard(self) -> None:
        u = self.engine.core.view(self.engine.current)
        top, low = float(u.max()), float(u.min())
        if np.isfinite(top) and np.isfinite(low) and max(top, -low) <= _EXPLODED * self._scale:
            return
        worst = np.unravel_index(int(np.argmax(np.where(np.isfinite(u), np.abs(u), np.inf))), u.shape)
        place = self._origin + self.lattice.spacing * np.array(worst[3 - self.lattice.dim :])
        backward = self.stencil.backward_waves()
        cause = (
            f"the stencil has backward waves, which grow in the layer (up to {backward.growth:.2g} sigma)" if backward
            else "check dt, sources and coefficient"
        )  # fmt: skip
        raise UnstableError(
            f"unstable at step {self.step_count}, t = {self.time:.6g}: u = {u[worst]:.3g} near {np.round(place, 6).tolist()}; likely cause: {cause}"
        )

    def run(self, until: float, every: float | None = None, progress: bool | None = None) -> Simulation:
        """Run to a time; observers are called every `every` time units and at the end.

        Parameters
        ----------
        until : float
            The run stops at the first step at or after it.
        every : float, optional
        progress : bool, optional
            Show a bar; on terminals only unless given.
        """
        from tqdm import tqdm

        if not np.isfinite(until):
            raise InputError("the end of the run must be finite", value=until, key="run.until")
        last = self.prepare(until)
        show = sys.stderr.isatty() if progress is None else progress
        with tqdm(total=max(last - self.step_count, 0), disable=not show, unit="step", leave=False) as bar:
            while self.step_count < last:
                if every is None:
                    stop = last
                else:
                    stop = min(last, int(np.ceil((int(self.time / every + 1e-9) + 1) * every / self.dt - 1e-9)))
                while self.step_count < stop:
                    before = self.step_count
                    self.step(min(self._guard_steps, stop - self.step_count))
                    bar.update(self.step_count - before)
                    if self.stop_requested and self.step_count < stop:
                        raise KeyboardInterrupt
                for observer in self.observers:
                    observer(self)
                if self.stop_requested and self.step_count < last:
                    raise KeyboardInterrupt
        return self

    # --- what comes out ----------------------------------------------------------------------------------------

    def _shown(self, level: np.ndarray, offset: float) -> np.ndarray:
        values = self.engine.core.view(level)[self._near].reshape(self.lattice.shape) + offset
        return self._visible(values)

    def _visible(self, values: np.ndarray) -> np.ndarray:
        """The values, nan on nodes that are not shown."""
        return values if self._hidden is None else np.where(self._hidden, np.nan, values)

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the near field."""
        out = {"u": self._shown(self.engine.current, self.background)}
        if self.model.order == 2:
            out["v"] = (out["u"] - self._shown(self.engine.older, self.background)) / self.dt
        if isinstance(self.model, Corrosion):
            steps = self.engine.dissolved[self._near].reshape(self.lattice.shape)
            out["solid"] = self._visible(self._solid.astype(float))
            out["dissolved"] = self._visible(np.where(self._solid, np.nan, self.dt * steps))
        return out

    def energy(self) -> float:
        """Energy of the near field; bonds across its edge count half.

        Waves: kinetic and strain energy half a step ago, ``1/2 v^2 + 1/4 sum_k w_k (u_k - u)(u_k^- - u^-)``, which the
        undamped scheme conserves exactly. Diffusion: ``1/2 integral (u - background)^2``.
        """
        engine, cell = self.engine, self.lattice.spacing**self.lattice.dim

        def near(level: np.ndarray) -> np.ndarray:
            part = engine.core.view(np.ascontiguousarray(level))[self._near].reshape(self.lattice.shape)
            return part if self.lattice.mask is None else part[self.lattice.mask]

        if self.model.order == 1:
            return float(0.5 * cell * (near(engine.current).astype(float) ** 2).sum())
        engine.fill(engine.current)
        u, old = engine.current.astype(float), engine.older.astype(float)
        if self._ends is not None:
            self._ends.fill(u, old)

        def apply(level: np.ndarray) -> np.ndarray:
            return engine.apply_core(level.astype(engine.dtype)).astype(float)

        strain = apply(u * old) - u * apply(old) - old * apply(u)
        kinetic = ((near(u) - near(old)) / self.dt) ** 2
        return float(cell * (0.5 * kinetic + 0.25 * near(strain)).sum())

    # --- heat balance ------------------------------------------------------------------------------------------

    def _open_books(self) -> None:
        """One book for each condition, each side that the field flows through, and the fixed rim: bonds from there into free nodes."""
        if self.model.order != 1:
            raise InputError("a balance is recorded for equations of first order in time", value=type(self.model).__name__, key="balance")
        engine, lead = self.engine, 3 - self.lattice.dim
        self._book_names = [f"constraint[{i}]" for i in range(len(self._setup["constraints"]))]
        core = np.zeros(engine.core.nodes)
        beyond = {}
        for (axis, side), boundary in self.sides.items():
            if isinstance(boundary, Periodic):
                continue
            self._book_names.append(AXES[axis] + "-+"[side > 0])
            beyond[lead + axis, side] = float(len(self._book_names))
            width = self._margins[axis, side]
            strip = slice(0, width) if side < 0 else slice(core.shape[lead + axis] - width, None)
            core[tuple(strip if a == lead + axis else slice(None) for a in range(3))] = len(self._book_names)
        near = core[self._near].reshape(self.lattice.shape)
        near.ravel()[self.conditions.nodes] = self.conditions.owner + 1
        if self.lattice.mask is not None and (self.rim == "fixed" or self._near_field is not None):
            self._book_names.append("rim" if self.rim == "fixed" else "outline")
            near[~self.lattice.mask] = len(self._book_names)
        core[self._near] = near.reshape(core[self._near].shape)
        self._free = near == 0
        where = np.round(engine.spread(core, beyond)).astype(int)
        block = engine.core
        flat, slots = block.node_indices(), block.slot_indices()
        found = []
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            other = slots + int(offset @ np.array(block.stride))
            flows = (where[slots] == 0) & (where[other] != 0)
            found.append((where[other[flows]] - 1, flat[flows], other[flows], np.full(int(flows.sum()), weight)))
        books, nodes, neighbours, weights = (np.concatenate([f[i] for f in found]) for i in range(4))
        weights = weights - engine.lost(nodes, neighbours)
        for number, leak in self.conditions.leaks:
            lossy = np.flatnonzero((leak > 0) & self._free)
            books = np.append(books, np.full(lossy.size, number))
            nodes, neighbours = np.append(nodes, self._near_indices()[lossy]), np.append(neighbours, np.full(lossy.size, -1))
            weights = np.append(weights, self.model.source_factor * leak.ravel()[lossy])
        kept = weights != 0
        if self._ends is None:
            ends = np.zeros((0, 0), np.int64)
        else:
            numbers = np.array([[self._book_names.index(name)] for name in self._ends.names])
            ends = np.where(where[self._ends.nodes] == 0, numbers, -1)
        flows_so_far = engine.flows
        effects = stage_effects(engine.stages) * np.array([n[2] for n in engine.stages.numbers])
        engine.set_books(books[kept], nodes[kept], neighbours[kept], weights[kept], effects, len(self._book_names), ends)
        if self.step_count:  # opened anew, as a crack has
            engine.flows[...] = flows_so_far
        else:
            self._powers = np.zeros(len(self._drives))
            self._first_amounts = self._amounts()

    def _amounts(self) -> dict[str, float]:
        """Sums of the field over the free nodes of the near field: "stored", and "metal" and "dissolved" of a corrosion."""
        near = self.engine.core.view(self.engine.current)[self._near].reshape(self.lattice.shape)

        def total(where: np.ndarray, level: float = 0.0) -> float:
            return math.fsum(near[self._free & where].astype(float) + level)

        phases = {"metal": self._solid, "dissolved": ~self._solid} if isinstance(self.model, Corrosion) else {}
        return {"stored": total(self._free)} | {name: total(where, self.background) for name, where in phases.items()}

    def _book_sources(self, fields: np.ndarray, amplitudes: np.ndarray) -> None:
        effects = stage_effects(self.engine.stages) * np.array([n[3] for n in self.engine.stages.numbers])
        totals = np.einsum("p,npj->j", effects, amplitudes) * fields[:, self._free.ravel()].sum(1)
        row, samples = 0, len(self.model.integrator.source_samples(self.dt)[0])
        for number, (space, _) in enumerate(self._drives):
            count = samples if space is None else 1
            self._powers[number] += totals[row : row + count].sum()
            row += count

    def balance(self) -> dict[str, float]:
        """What the near field has gained since the start, and from where, for simulations with ``balance=True``.

        Free nodes count: those that no condition prescribes. Every entry is heat (the field's integral for a diffusion): heat capacity
        times cell volume times temperature.

        Returns
        -------
        dict
            "stored", the gain, of a corrosion the sum of the gains of "metal" (what it has lost, negative) and "dissolved" (of the liquid);
            "source[i]", "constraint[i]", "x-", .. and "rim" or "outline": what came in from there; "residual": "stored" less all that came in,
            which is rounding.

        Raises
        ------
        InputError
            The simulation does not record it.
        """
        if not self._balance:
            raise InputError("this simulation records no balance", key="balance", remedy="Simulation(..., balance=True)")
        unit = self.lattice.spacing**self.lattice.dim / self.model.source_factor
        inflow = {name: unit * float(value) for name, value in zip(self._book_names, self.engine.flows.sum(0), strict=True)}
        owners = [f"source[{i}]" for i in range(len(self.sources))] + [f"constraint[{i}]" for i, _ in self.conditions.sources]
        for name, power in zip(owners, self._powers, strict=True):
            inflow[name] = inflow.get(name, 0.0) + unit * float(power)
        gains = {name: unit * (amount - self._first_amounts[name]) for name, amount in self._amounts().items()}
        return {**gains, **inflow, "residual": gains["stored"] - math.fsum(inflow.values())}

    # --- flux --------------------------------------------------------------------------------------------------

    def _bonds(self) -> Callable[[int], np.ndarray]:
        """Factor of the bond from each node of the near field along an offset, given by its number; 0 where there is none within it."""
        engine = self.engine
        block = engine.core
        nodes, slots = block.node_indices()[self._near].ravel(), block.slot_indices()[self._near].ravel()
        inside = np.zeros(engine.layout.places, bool)
        inside[nodes] = True

        def factor(number: int) -> np.ndarray:
            other = slots + int(engine.offsets[number] @ np.array(block.stride))
            left = engine.bond_factors(nodes, other) * (1 - engine.lost(nodes, other) / engine.weights[number])
            return np.where(inside[other] & (left > 1e-12), left, 0.0).reshape(self.lattice.shape)

        return factor

    def _flux_tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[int], np.ndarray]]:
        u = self.engine.core.view(self.engine.current)[self._near].reshape(self.lattice.shape).astype(float)
        return u, self.stencil.offsets, self.stencil.weights * self.model.coefficient / self.model.source_factor, self._bonds()

    def flux(self) -> np.ndarray:
        """Heat flux (or that of a diffusing field) at the nodes along each axis, positive towards larger coordinates.

        One-sided sums over the bonds ahead of a node, over those behind it where bonds ahead are missing, exact for a linear field at every
        node; nan where the bonds left do not determine it. See `farhorizon.analysis.flux`.

        Returns
        -------
        ndarray, shape (dim, n..)
        """
        found = nodal_flux(*self._flux_tables(), self.lattice.spacing)
        return found if self.lattice.mask is None else np.where(self.lattice.mask, found, np.nan)

    def power_across(self, axis: str, position: float) -> float:
        """Power that crosses a plane, towards larger coordinates: the sum over the bonds of the near field that cross it.

        Parameters
        ----------
        axis : {"x", "y", "z"}
            Normal of the plane.
        position : float
            Coordinate of the plane, taken to the nearest middle between two nodes.

        Raises
        ------
        InputError
            An axis that the lattice has not, a plane outside it.
        """
        if axis not in AXES[: self.lattice.dim]:
            raise InputError("the lattice has no such axis", value=axis, limit=", ".join(AXES[: self.lattice.dim]), key="axis")
        number = AXES.index(axis)
        row = int(np.floor((position - self.lattice.lower[number]) / self.lattice.spacing + 1e-9))
        if not 0 <= row < self.lattice.shape[number] - 1:
            raise InputError("the plane lies outside the near field", value=position, key="position",
                             limit=f"{self.lattice.lower[number]} to {self.lattice.upper[number]}")  # fmt: skip
        return power_across(*self._flux_tables(), self.lattice.spacing, number, row)

    @property
    def notes(self) -> list[str]:
        """What lies beyond the near field and is missed, but within the sides' targets, or cannot be known."""
        return self._beyond.notes + (self._ends.notes() if self._ends is not None else [])

    @property
    def ends(self) -> dict[str, str]:
        """What serves each exact end: modes and error bound of its sum, and for how many steps."""
        return {} if self._ends is None else {name: self._ends.describe(i, self.dt) for i, name in enumerate(self._ends.names)}

    def remade(self, **changes: Any) -> Simulation:
        """The same set-up at its start with some arguments changed; on another lattice nothing is there, and the medium is uniform."""
        start: dict[str, Any] = {}
        if "lattice" in changes:
            nothing = dict.fromkeys(("sources", "cracks", "constraints", "specimens"), ())
            changes = {**nothing, "coefficient": None, "rim": "free", "balance": False, **changes}
        else:
            start["u"] = self.start_u + float(changes.get("background", self.background))
            start |= {"v": self.start_v} if self.model.order == 2 else {}
        return Simulation(**{**self._setup, "initial": start, **changes})

    @property
    def exact_ends(self) -> ExactEnds | None:
        """The exact ends; None without."""
        return self._ends

    def leak(self) -> np.ndarray:
        """Rate at which each node loses its value to what surrounds the body; of the lattice's shape, empty without."""
        leaks = [leak for _, leak in self.conditions.leaks]
        return self.model.source_factor * sum(leaks[1:], leaks[0]) if leaks else np.zeros(0)

    def certificate(self, budget: float = BUDGET) -> Certificate:
        """Whether the complete update, near field and all memory of the boundaries, is stable; see `farhorizon.certificate`.

        Parameters
        ----------
        budget : float
            Seconds that it may take; what is not examined in that time is named.
        """
        return certify(self, budget)

    def seconds_per_step(self) -> float:
        """Time of a step on this machine now, measured for a tenth of a second without sources; the state stays as it is."""
        engine = self.engine
        with engine.as_before():
            engine.advance_alone(1)  # the first one loads compiled programs
            count, spent = 1, 0.0
            while spent < 0.05 and count < 10_000:
                count = count if spent == 0 else int(count * np.clip(0.1 / spent, 2, 50))
                begin = perf_counter()
                engine.advance_alone(count)
                spent = perf_counter() - begin
        return spent / count

    def check(self, until: float | None = None, budget: float | None = None) -> Report:
        """Step limit, stability certificate, predicted reflection, layer, memory, time, warnings and notes, before running.

        Parameters
        ----------
        until : float, optional
            End of the run, for its estimated time.
        budget : float, optional
            Seconds for the certificate; unless given as many as the run to `until`, from 2 to 30; 30 without `until`.
        """
        return Report.of(self, until, budget)

    # --- state -------------------------------------------------------------------------------------------------

    def _fingerprint(self) -> dict[str, Any]:
        engine = self.engine
        return {
            "levels": list(engine.levels.shape), "memory": int(engine.memory.size), "dtype": engine.dtype.name, "dt": self.dt,
            "shape": list(self.lattice.shape), "spacing": self.lattice.spacing, "lower": self.lattice.lower.tolist(),
            "model": type(self.model).__name__, "coefficient": self.model.coefficient, "damping": self.model.damping,
            "weights": float(self.stencil.weights.sum()), "neighbours": len(self.stencil.weights), "cuts": self._first_cuts,
            "held": len(self._held), "conditions": len(self.conditions.nodes), "opens": [c.opens for c in self._cracks],
            **({} if self._ends is None else {"exact": self._ends.names}),
            **({} if self.closure is None else {"fringe": list(self.engine.fringe_history.shape), "update": self.closure.mark()}),
            **({"constraints": len(self._holds.constraints)} if self._holds.constraints else {}),
            **({"solid": self._first_solid, "saturation": self.model.saturation, "interface": self.model.interface}
               if isinstance(self.model, Corrosion) else {}),
        }  # fmt: skip

    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state, boundary memory included, under a temporary name and rename it."""
        meta = {"fingerprint": self._fingerprint(), "step": self.step_count, "phase": int(self.engine.phase), "scale": self._scale, "extra": extra}
        arrays = {
            "levels": self.engine.levels,
            "memory": self.engine.memory,
            "start_u": self.start_u,
            "start_v": self.start_v,
        }
        if self._ends is not None:
            more, meta["exact"] = self._ends.save()
            arrays |= more
        if isinstance(self.model, Corrosion):
            arrays["dissolved"] = np.ascontiguousarray(self.engine.dissolved[self._near])
        if self.closure is not None:
            arrays["fringe"] = self.engine.fringe_history
        if self._balance:
            arrays |= {"flows": self.engine.flows, "powers": self._powers}
            meta["first_amounts"] = self._first_amounts
        meta["setup"] = describe(self._setup, arrays)
        write_checkpoint(path, arrays, meta)

    @classmethod
    def restore(cls, path: str | Path, **changes: Any) -> Simulation:
        """The simulation that wrote a checkpoint, in the state in which it was saved.

        Parameters
        ----------
        path : str or Path
        **changes
            Arguments of the constructor to take instead of the stored ones: needed for Python functions (sources),
            which a file cannot hold, and for observers.

        Raises
        ------
        InputError
            The set-up held a Python function that is not given again.
        FileFormatError
            A damaged or foreign file, or changes that make another set-up.
        """
        arrays, meta = read_checkpoint(path)
        if "setup" not in meta:
            raise FileFormatError("the file holds no set-up", value=str(path), remedy="a checkpoint written by Simulation.save")
        stored = {k: v for k, v in meta["setup"]["dict"].items() if k not in changes}
        setup = {k: rebuild(v, arrays, k) for k, v in stored.items()}
        initial = {"u": arrays["start_u"] + rebuild(meta["setup"]["dict"]["background"], arrays)}
        if np.any(arrays["start_v"]):
            initial["v"] = arrays["start_v"]
        sim = cls(**{**setup, "initial": initial, **changes})
        sim.load(path)
        return sim

    def load(self, path: str | Path) -> dict[str, Any]:
        """Take the state of a checkpoint written by the same set-up; what follows is bitwise the uninterrupted run.

        Raises
        ------
        FileFormatError
            A damaged file, or the checkpoint of another set-up.
        """
        arrays, meta = read_checkpoint(path)
        mine = json.loads(json.dumps(self._fingerprint()))
        theirs = meta.get("fingerprint", {})
        different = sorted(k for k in {*mine, *theirs} if mine.get(k) != theirs.get(k))
        if different:
            raise FileFormatError("the checkpoint belongs to another set-up", value=str(path), limit=f"same {', '.join(different)}",
                                  remedy="resume with the case that wrote it")  # fmt: skip
        self.engine.levels[...] = arrays["levels"]
        self.engine.memory[...] = arrays["memory"]
        if self._ends is not None:
            self._ends.load(arrays, meta["exact"])
        if self.closure is not None:
            self.engine.fringe_history[...] = arrays["fringe"]
        self.engine.phase, self._scale = int(meta["phase"]), float(meta["scale"])
        self.step_count = 0
        self._tick(int(meta["step"]))
        self.engine.steps_done = self.step_count
        if isinstance(self.model, Corrosion):
            self._set_phases(arrays["dissolved"])
        self._hold()
        self._open_cracks()
        if self._balance:
            self.engine.flows[...], self._powers[...] = arrays["flows"], arrays["powers"]
            self._first_amounts = meta["first_amounts"]
        return dict(meta["extra"])
