"""What a gradient refuses, before any run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import nodes_in
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.local_sources import ANGLES, LineSource, MomentTensor, PointForce, PointSource
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.sources import Source
from farhorizon.inverse.misfits import Misfit
from farhorizon.medium.integrators import Euler, Verlet
from farhorizon.medium.of_field import OfField
from farhorizon.simulation.setup.compatibility import check_lossless
from farhorizon.simulation.setup.setup import Setup, keys, side_name
from farhorizon.simulation.simulation import Simulation
from farhorizon.simulation.time.source_terms import given, split_source_terms

_INITIAL = ("u", "v")
#: Parameters of local sources by which there are derivatives.
_PARAMETERS: dict[type, tuple[str, ...]] = {
    PointSource: ("at", "strength"),
    PointForce: ("at", "force"),
    MomentTensor: ("at", "moment", *ANGLES),
    LineSource: ("strength",),
}


@dataclass(frozen=True)
class Asked:
    """What a gradient is taken by: constants of the medium, "u" and "v", names of sources, and of their parameters
    ("source.at").
    """

    constants: tuple[str, ...]
    initial: tuple[str, ...]
    sources: tuple[str, ...]
    parameters: tuple[str, ...]

    def spaces(self, sim: Simulation) -> dict[str, list[np.ndarray]]:
        """Return, for each of the sources, its parts as functions of space, each of the field's shape."""
        fields = {}
        parts = given(sim.setup, sim.parts.near, sim.parts.layered.sides)
        for name in self.sources:
            source_terms = split_source_terms(
                [one for one in parts if one[0] == name], sim.parts.near, sim.parts.exterior
            )
            fields[name] = [np.asarray(space) for space, _ in source_terms.sources if space is not None]
            if source_terms.unsplit:
                raise InputError(
                    "the source is not a function of space times one of time",
                    key=name,
                    remedy="Source(space, time), or a PointSource",
                )
        return fields


class SourceSlopes(NamedTuple):
    """Derivatives of a source by one of its parameters: on the nodes, (entries, *field), as many as the parameter has
    entries, its shape, and the factor of time.
    """

    fields: np.ndarray
    shape: tuple[int, ...]
    time: Callable[[float], float]


def source_slopes(sim: Simulation, name: str) -> SourceSlopes:
    """Return the derivatives of a source by one of its parameters; an InputError where the interpolation's weights have
    a kink.
    """
    near, (key, _, parameter) = sim.parts.near, name.rpartition(".")
    source = dict(zip(keys("source", sim.setup.sources), sim.setup.sources, strict=True))[key]
    lattice, components = near.lattice, near.stencil.components
    value, cuts = np.asarray(getattr(source, parameter), float), [crack.cut for crack in sim.setup.cracks]
    if parameter in ANGLES:
        sources = [Source(source.turned(lattice, key, parameter), source.time)]
    elif parameter == "at":
        fields = [source.moved(lattice, components, key, axis, cuts) for axis in range(lattice.dim)]
        sources = [Source(field, source.time) for field in fields]
    else:  # linear: the derivative by an entry is the source of a unit
        units = np.eye(value.size).reshape(-1, *value.shape)
        if value.ndim == 2:  # a moment tensor is symmetric
            units = (units + units.swapaxes(1, 2)) / 2
        sources = [replace(source, **{parameter: unit.tolist()}).placed(lattice, components, key)[0] for unit in units]
    terms = split_source_terms([(key, one) for one in sources], near, sim.parts.exterior)
    return SourceSlopes(np.stack([np.asarray(space) for space, _ in terms.sources]), value.shape, terms.sources[0][1])


def asked_for(setup: Setup, wrt: str | Sequence[str]) -> Asked:
    """Return what a gradient is taken by; an InputError for a word without meaning, a constant or a source that is not
    there.
    """
    names = [wrt] if isinstance(wrt, str) else kinds.sequence(wrt, "wrt", "names")
    if not names:
        raise InputError("a gradient is taken by something", value=names, limit="a name", key="wrt", remedy='"speed"')
    sources = keys("source", setup.sources)
    initial = _INITIAL[: setup.model.order]
    parameters = [
        f"{key}.{name}"
        for key, source in zip(sources, setup.sources, strict=True)
        for name in _PARAMETERS.get(type(source), ())
        if getattr(source, name) is not None
    ]
    known = [*setup.model.wave_constants, *initial, *sources, *parameters]
    for name in names:
        kinds.one_of(name, "wrt", known, f"{setup.model.title} has no such parameter, or the run no such source")
    constants = tuple(name for name in names if name in setup.model.wave_constants)
    of_sources = [tuple(name for name in names if name in some) for some in (initial, sources, parameters)]
    return Asked(constants, *of_sources)


def check_linear(setup: Setup, asked: Asked) -> None:
    """Refuse runs whose operator is not linear, or not reciprocal, so that their adjoint is no run of the same kind."""
    for (axis, side), boundary in setup.sides.items():
        if boundary.closing or boundary.derivatives:
            raise InputError(
                "the side is not reciprocal: a wave from A arrives at B otherwise than one from B at A",
                value=type(boundary).__name__,
                limit="LatticePML, Exact, Extended, Sponge, Fixed, Free, Impedance, Periodic",
                key=f"boundary.{side_name(axis, side)}",
                remedy="LatticePML(), which continues the infinite lattice",
            )
    _check_model(setup)
    for key, crack in zip(keys("crack", setup.cracks), setup.cracks, strict=True):
        if crack.opens > 0:
            raise InputError(
                "the adjoint runs backwards, in which a crack that opens would close",
                value=crack.opens,
                limit="<= 0",
                key=f"{key}.opens",
                remedy="a crack that is open from the start",
            )
    if setup.impactors:
        raise InputError(
            "contact with an impactor is not linear",
            value=f"{len(setup.impactors)} impactors",
            key=next(iter(setup.impactors)),
            remedy="a load with the force that Impacts records",
        )
    for key, constraint in zip(keys("constraint", setup.constraints), setup.constraints, strict=True):
        if not isinstance(constraint, Prescribed) or constraint.until is not None:
            raise InputError(
                "there is no adjoint of this condition",
                value=type(constraint).__name__
                if not isinstance(constraint, Prescribed)
                else f"until = {constraint.until:g}",
                limit="Prescribed nodes that are never released",
                key=key,
                remedy="Fixed sides, or Prescribed without until",
            )
    if asked.constants and setup.rule == "both":
        raise InputError(
            "the smaller of two constants has no derivative where both are equal",
            value="both",
            limit="arithmetic, harmonic",
            key="rule",
            remedy='rule="harmonic"',
        )
    if asked.constants and setup.rim == "fixed":
        raise InputError(
            "bonds to a fixed rim have no constants of their own",
            value="fixed",
            limit="free",
            key="rim",
            remedy="Prescribed nodes along the rim",
        )


def _check_model(setup: Setup) -> None:
    """Refuse models that are not linear, or integrators of several stages."""
    model, law = setup.model, setup.model.bond_law
    if law is not None:
        flags = {name: True for name in ("nonlinear", "contact", "softening", "law", "warm") if getattr(law, name)}
        limits = ("critical_stretch", "fracture_energy")
        flags |= {name: getattr(law, name) for name in limits if getattr(law, name, None) is not None}
        for name, value in flags.items():
            raise InputError(
                "bonds that follow a law of their own stretch are not linear: there is no adjoint run",
                value=value,
                limit="linear bonds that hold",
                key="load" if name == "warm" else f"model.{name}",
                remedy="leave it out: small waves do not break bonds",
            )
    check_lossless(model, "gradient", "a model without attenuation")
    if model.drag:
        raise InputError(
            "drag is no force: it moves nodes towards the mean of neighbours that are there, heavy or light, "
            "so that the run is not reciprocal",
            value=model.drag,
            limit=0.0,
            key="model.drag",
            remedy="damping, or a Sponge",
        )
    if model.stiffens_surfaces:
        raise InputError(
            "there is no adjoint of corrected surfaces",
            value='surface = "energy"',
            key="model.surface",
            remedy="leave it out",
        )
    follows = [f"model.{name}" for name in model.follows]
    named = zip(keys("source", setup.sources), setup.sources, strict=True)
    for key in [*follows, *(key for key, source in named if isinstance(source, OfField))]:
        raise InputError(
            "what depends on the field is not linear: there is no adjoint run",
            value="OfField",
            limit="functions of space and time",
            key=key,
            remedy="its value at the background",
        )
    if model.dissolution is not None:
        raise InputError(
            "a medium that dissolves is not linear",
            value=model.title,
            limit="Wave, Diffusion, Heat, Elastic",
            key="model",
            remedy="Diffusion, for the liquid alone",
        )
    if not isinstance(model.integrator, Verlet | Euler):
        raise InputError(
            "there is no adjoint of schemes of several stages here",
            value=model.integrator.name,
            limit="euler",
            key="model.integrator",
            remedy='integrator="euler"',
        )


def default_region(sim: Simulation) -> np.ndarray:
    """Return the nodes whose medium no side continues, as a mask of the lattice's shape."""
    inside = np.ones(sim.lattice.shape, bool)
    if sim.lattice.mask is not None:
        inside &= sim.lattice.mask
    for (axis, side), boundary in sim.sides.items():
        if not boundary.endless:
            continue
        edge = sim.stencil.reach[axis] + 1
        near = slice(None, edge) if side < 0 else slice(-edge, None)
        inside[tuple(near if a == axis else slice(None) for a in range(inside.ndim))] = False
    return inside


def check_region(region: Any, sim: Simulation, asked: Asked) -> np.ndarray:
    """Return a region as a mask of the lattice's shape; an InputError if it is empty, leaves the body, or comes within
    one reach of an absorbing side.
    """
    most = default_region(sim)
    if asked.constants and np.any(sim.stencil.reaction):
        raise InputError(
            "a reaction has no definite strength in a medium that varies",
            value="a reaction",
            limit="none",
            key="model.reaction",
            remedy="leave it out, or ask for sources and initial data alone",
        )
    if not asked.constants:
        return most if most.any() else np.ones(sim.lattice.shape, bool)
    if region is None:
        inside = most
    elif isinstance(region, Shape):
        inside = nodes_in(region, sim.lattice, "region")
        inside = inside if sim.lattice.mask is None else inside & sim.lattice.mask
    else:
        inside = kinds.mask(region, "region")
        if inside.shape != sim.lattice.shape:
            raise InputError(
                "a region has the lattice's shape",
                value=inside.shape,
                limit=sim.lattice.shape,
                key="region",
                remedy="one value a node, or a shape",
            )
    if not inside.any():
        raise InputError(
            "the region has no node", value=0, limit=">= 1", key="region", remedy="a larger region, or a larger lattice"
        )
    if (inside & ~most).any():
        raise InputError(
            "the region reaches into what a side continues, or outside the body",
            value=f"{int((inside & ~most).sum())} nodes",
            limit=f"more than {max(sim.stencil.reach)} nodes from sides that absorb",
            key="region",
            remedy="region=None takes all nodes that are allowed; a larger lattice has more",
        )
    return inside


def misfits_of(given: Any, key: str = "misfit") -> list[Misfit]:
    """Return one or several misfits as a list; raises InputError for anything else."""
    misfits = [given] if isinstance(given, Misfit) else kinds.sequence(given, key, "misfits")
    for i, one in enumerate(misfits):
        name = f"{key}[{i}]" if len(misfits) > 1 else key
        kinds.instance(one, name, Misfit, "a misfit", "LeastSquares(receivers, data)")
    return misfits


def check_misfits(misfits: Sequence[Misfit], steps: int, components: int) -> None:
    """Refuse misfits whose data do not fit a run of some steps."""
    if not misfits:
        raise InputError(
            "there is no misfit", value=0, limit=">= 1", key="misfit", remedy="LeastSquares(receivers, data)"
        )
    for i, misfit in enumerate(misfits):
        key = f"misfit[{i}]" if len(misfits) > 1 else "misfit"
        try:
            misfit.check(steps // misfit.receivers.every + 1, components)
        except InputError as error:
            raise error.at(error.key.replace("misfit", key, 1)) from None


def shots_of(shots: Any) -> list[tuple[Setup, list[Misfit]]]:
    """Return shots as pairs of a set-up and a list of misfits; an InputError for anything else, or none."""
    given = kinds.sequence(shots, "shots", "pairs (set-up, misfit)")
    if not given:
        raise InputError("there is no shot", value=0, limit=">= 1", key="shots", remedy="[(setup, misfit)]")
    return [_shot(one, i) for i, one in enumerate(given)]


def _shot(given: Any, number: int) -> tuple[Setup, list[Misfit]]:
    key = f"shots[{number}]"
    if not (isinstance(given, list | tuple) and len(given) == 2):
        raise InputError("a shot is a set-up and a misfit", value=kinds.said(given), key=key, remedy="(setup, misfit)")
    setup = kinds.instance(given[0], f"{key}.setup", Setup, "a Setup")
    return setup, misfits_of(given[1], f"{key}.misfit")
