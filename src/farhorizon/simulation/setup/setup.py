"""The set-up of a run: all that a user specifies, as one value that can be run, stored, described and changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries import LatticePML, Side, sides
from farhorizon.engine.engine import available_threads
from farhorizon.errors import InputError, suggestion
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.inputs.conditions import Constraint
from farhorizon.inputs.cracks import as_crack
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.impactors import Impactor
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.inputs.loads import BodyForce, Load, Traction
from farhorizon.inputs.local_sources import LocalSource
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.pressure import Pressure
from farhorizon.inputs.sources import Source, as_source
from farhorizon.inputs.specimens import Specimen
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.medium.of_field import OfField, names_field
from farhorizon.models import LatticeModel
from farhorizon.simulation.heat.two_fields import of_one_field
from farhorizon.simulation.pickling import check_picklable
from farhorizon.simulation.setup.laws import conductivity_ratio, law_of

Key = tuple[int, int]  # axis and side, -1 or +1
Sides = dict[Key, Any]  # the boundary on each side


def keys(name: str, values: Sequence[Any]) -> list[str]:
    """Return the names of the entries of a list in messages."""
    return [f"{name}[{i}]" for i in range(len(values))] if len(values) > 1 else [name] * len(values)


def side_name(axis: int, side: int) -> str:
    """Return the name of a side, "x-", "x+", .., from its axis and -1 or +1."""
    return AXES[axis] + "-+"[side > 0]


def wanted_threads(threads: int | None) -> int:
    """Return the number of threads, all that are available unless given; raises InputError for an impossible one."""
    if threads is None:
        return available_threads()
    try:
        return kinds.integer(threads, "threads", least=1, most=available_threads())
    except InputError as error:
        raise InputError(
            "not a number of threads that there are",
            value=error.value,
            limit=error.limit,
            key="threads",
            remedy="leave it out, or set NUMBA_NUM_THREADS before the program starts",
        ) from None


def _parsed_source(source: Any, dim: int, key: str) -> Any:
    """Return a source with every text in it converted to an expression."""
    if isinstance(source, Load):
        raise InputError(
            "a load is not a source",
            value=source,
            limit="Source, PointSource and others, IncidentWave and others, functions, expressions",
            key=key,
            remedy=f"loads=[{type(source).__name__}(...)]",
        )
    if isinstance(source, Incident):
        return source.on(dim)
    text = source.value if isinstance(source, Source) and source.time is None else source
    if names_field(text):
        source = OfField(text)
    if isinstance(source, OfField):
        law_of(source, ("u", *AXES[:dim]), key)  # refuses what is not one
        return source
    return source if isinstance(source, LocalSource) else as_source(source, dim, key)


def _check_coupled(heat: Setup, lattice: Lattice, key: str) -> None:
    """Raise InputError unless a coupled temperature has a heat capacity and the nodes of the solid."""
    if heat.model.heat_capacity is None:
        raise InputError(
            "only what has a heat capacity is heated by a deformation", value=heat.model.title, key=key, limit="Heat"
        )
    heat_lattice = heat.lattice
    alike = heat_lattice.shape == lattice.shape and np.allclose(
        [heat_lattice.lower, heat_lattice.upper], [lattice.lower, lattice.upper]
    )
    masks = [np.ones(nodes.shape, bool) if nodes.mask is None else nodes.mask for nodes in (heat_lattice, lattice)]
    if not alike or not np.array_equal(masks[0], masks[1]):
        raise InputError(
            "the temperature is computed on nodes that are not those of the solid",
            value=f"{heat_lattice.shape} nodes from {heat_lattice.lower.tolist()}",
            limit=f"{lattice.shape} nodes from {lattice.lower.tolist()}",
            key=key,
            remedy="the same lattice, or coupled=False",
        )


@dataclass(frozen=True, eq=False)
class Setup:
    """All that a user specifies for a run; `Simulation.of` creates the simulation.

    Use ``dataclasses.replace`` to change it. Attributes are stored in their final form: texts are converted to
    expressions, cracks to `Crack`, and `boundary` names a side for every side of the lattice. Whether the arguments are
    compatible with one another is checked when the simulation is created.

    Parameters
    ----------
    lattice, model, boundary, initial, sources, cracks, coefficient, background, dt, dtype, threads, rule, rim, \
constraints, balance, specimens, loads
        As in `Simulation`.

    Raises
    ------
    InputError
        An argument of another type than `Simulation` requires.

    Examples
    --------
    >>> import farhorizon as fh
    >>> from dataclasses import replace
    >>> setup = fh.Setup(fh.Lattice(1.0, -20, 20), fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-x**2/8)"})
    >>> sim = fh.Simulation.of(replace(setup, boundary=fh.Fixed()))
    >>> sim.setup.boundary
    {'x-': Fixed(value=0.0), 'x+': Fixed(value=0.0)}
    """

    lattice: Lattice
    model: LatticeModel
    boundary: Side | Mapping[str, Side] | None = None
    initial: Mapping[str, Any] | None = None
    sources: Sequence[Any] = ()
    cracks: Sequence[Any] = ()
    coefficient: Any = None
    background: float = 0.0
    dt: float | Callable[[float], float] | LoadSteps | None = None
    dtype: str = "float64"
    threads: int | None = None
    rule: str | None = None
    rim: str = "free"
    constraints: Sequence[Constraint | Prescribed] = ()
    balance: bool = False
    specimens: Sequence[Specimen] = ()
    loads: Sequence[Load] = ()

    def __post_init__(self) -> None:
        lattice = kinds.instance(self.lattice, "lattice", Lattice, "a Lattice")
        kinds.instance(
            self.model,
            "model",
            LatticeModel,
            "a model",
            remedy="Wave, Diffusion, Heat, Corrosion, Elastic, Thermoelastic or Beam",
        )
        self.model.check()
        if self.model.of_temperature is not None:
            kinds.set_fields(self, **of_one_field(self.arguments, Setup))
        initial = {} if self.initial is None else self.initial
        kinds.set_fields(self, background=kinds.number(self.background, "background"))
        kinds.instance(initial, "initial", Mapping, "a mapping of fields to their values", remedy='{"u": ...}')
        for name in ("sources", "specimens", "loads", "cracks", "constraints"):
            kinds.set_fields(self, **{name: tuple(kinds.sequence(getattr(self, name), name))})
        kinds.flag(self.balance, "balance")
        beyond = sides(LatticePML() if self.boundary is None else self.boundary, lattice.dim)
        real = kinds.number_type(self.dtype)
        kinds.set_fields(self, dtype=kinds.one_of(real, "dtype", ("float64", "float32"), "unknown number type"))
        if self.rule is not None:
            kinds.one_of(self.rule, "rule", ("both", "arithmetic", "harmonic"), "unknown bond rule")
        kinds.one_of(self.rim, "rim", ("free", "fixed"), "unknown surface of a body")
        wanted_threads(self.threads)
        if self.rim == "fixed" and lattice.body is None:
            raise InputError(
                "only a body has a surface",
                value=self.rim,
                key="rim",
                remedy="give the lattice a body, or fix the sides: Fixed(...)",
            )
        loads: list[Load] = []
        for i, load in enumerate(self.loads):
            remedy = "sources=[...]" if isinstance(load, Source | LocalSource | Incident) else ""
            words = "a BodyForce, Traction, Pressure, Impactor or ThermalLoad"
            known = kinds.instance(load, f"load[{i}]", Load, words, remedy).resolved(lattice)
            loads.append(
                kinds.instance(known, f"load[{i}]", (BodyForce, Traction, Pressure, Impactor, ThermalLoad), words)
            )
        if loads:
            kinds.set_fields(self, loads=tuple(loads))
            self._resolve_heat()
        kinds.set_fields(
            self,
            boundary={side_name(*key): boundary for key, boundary in beyond.items()},
            initial={k: as_given(value, lattice.dim, f"initial.{k}", time=False) for k, value in initial.items()},
            sources=tuple(
                _parsed_source(source, lattice.dim, key)
                for source, key in zip(self.sources, keys("source", self.sources), strict=True)
            ),
            cracks=tuple(as_crack(crack, lattice.dim) for crack in self.cracks),
            coefficient=None
            if self.coefficient is None
            else as_given(self.coefficient, lattice.dim, "coefficient", time=False),
        )
        if self.model.follows and lattice.whole is lattice:  # a part has the model of the whole
            background = np.array(self.background)
            laws = {name: law_of(quantity, ("u",), f"model.{name}") for name, quantity in self.model.follows.items()}
            strongest = conductivity_ratio(self)
            levels = {name: float(law(background)) for name, law in laws.items()}
            kinds.set_fields(self, model=self.model.around(levels, strongest))

    def __reduce_ex__(self, protocol: Any) -> Any:
        check_picklable(self.arguments)
        return super().__reduce_ex__(protocol)

    def __copy__(self) -> Setup:
        return self  # frozen

    def __deepcopy__(self, memo: dict[int, Any]) -> Setup:
        made = object.__new__(type(self))  # functions, which cannot be pickled, are copied as they are
        made.__dict__.update(deepcopy(self.__dict__, memo))
        return made

    def _resolve_heat(self) -> None:
        """Settle the thermal load: its texts become expressions, and the model one with thermal strains."""
        thermal = [(i, entry) for i, entry in enumerate(self.loads) if isinstance(entry, ThermalLoad)]
        if len(thermal) > 1:
            key, remedy = f"load[{thermal[1][0]}]", "add the temperatures up"
            raise InputError(
                "a solid has one temperature", value=f"{len(thermal)} thermal loads", key=key, remedy=remedy
            )
        for i, load in thermal:
            key, given = f"load[{i}].temperature", load.temperature
            if not load.of_run(given):
                given = as_source(given, self.lattice.dim, key)
            elif kinds.instance(given, key, Setup, "a run, or its set-up").model.order > 1 or given.model.dissolution:
                raise InputError(
                    "a temperature is a field that diffuses", value=given.model.title, key=key, limit="Heat, Diffusion"
                )
            if load.coupled:
                _check_coupled(given, self.lattice, key)
            loads = [replace(entry, temperature=given) if entry is load else entry for entry in self.loads]
            kinds.set_fields(self, model=self.model.heated(load.coupled), loads=tuple(loads))

    @property
    def heat(self) -> ThermalLoad | None:
        """The thermal load of the solid; None if there is none."""
        return next((load for load in self.loads if isinstance(load, ThermalLoad)), None)

    @property
    def impactors(self) -> dict[str, Impactor]:
        """The impactors among the loads, by their names in messages."""
        return {f"load[{i}]": load for i, load in enumerate(self.loads) if isinstance(load, Impactor)}

    @property
    def sides(self) -> Sides:
        """The boundary on each side by (axis, side), side = -1 or +1."""
        return sides(self.boundary, self.lattice.dim)

    @property
    def bond_rule(self) -> str:
        """How the coefficients of the two ends of a bond are combined."""
        return self.rule or ("harmonic" if self.model.uneven else "both")

    @property
    def load_steps(self) -> LoadSteps | None:
        """The load steps that replace time steps; None if the run goes on in time."""
        return self.dt if isinstance(self.dt, LoadSteps) else None

    @property
    def lasting(self) -> bool:
        """Whether the older time level is kept after a step, as required by the energies of individual bonds, by drag,
        by the work of sources and by load steps.
        """
        kept = self.model.bond_law is not None or self.model.drag > 0 or self.load_steps is not None
        return kept or (self.balance and (self.model.mechanical or self.model.attenuation is not None))

    @property
    def depends_on_field(self) -> bool:
        """Whether a source or a constant of the model depends on the field."""
        return bool(self.model.follows) or any(isinstance(source, OfField) for source in self.sources)

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments by their names in `Simulation`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def check_names(changes: Iterable[str]) -> None:
    """Raise InputError for a change of an argument that a set-up does not have."""
    known = [field.name for field in fields(Setup)]
    for name in changes:
        if name not in known:
            raise InputError("a set-up has no such argument", value=name, key=name, remedy=suggestion(name, known))


def wrapping(sides: Sides) -> frozenset[int]:
    """Return the periodic axes."""
    return frozenset(axis for (axis, _), side in sides.items() if side.periodic)


def within_part(value: Any, lattice: Lattice, within: tuple[slice, ...]) -> Any:
    """Return the part of a value in a box of the lattice: slices of arrays over the lattice, of one or more components,
    also in lists; anything else is returned unchanged.
    """
    if isinstance(value, np.ndarray) and value.shape[-lattice.dim :] == lattice.shape:
        place: tuple[Any, ...] = (..., *within)
        return value[place]
    if isinstance(value, list | tuple):
        return type(value)(within_part(entry, lattice, within) for entry in value)
    return value
