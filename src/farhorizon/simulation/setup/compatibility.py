"""Checks that the parts of a set-up are compatible: a model with sides, bonds and phases, a stencil with a lattice."""

from __future__ import annotations

import itertools

import numpy as np

from farhorizon.boundaries import names
from farhorizon.boundaries.side import Assumption
from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import AXES
from farhorizon.inputs.cracks import cut_bonds
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.medium.integrators import Euler, ModifiedEquation, Verlet
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation
from farhorizon.models import LatticeModel
from farhorizon.simulation.setup.reference_medium import constants_of
from farhorizon.simulation.setup.setup import Setup, Sides, keys, side_name


def check_model(setup: Setup, sides: Sides) -> None:
    """Refuse sides, bonds, phases and loads that the model does not support."""
    model, cracks, coefficient = setup.model, setup.cracks, setup.coefficient
    for key, boundary in sides.items():
        if not model.serves(type(boundary)):
            raise InputError(
                f"{model.title} has no such side",
                value=type(boundary).__name__,
                limit=names(lambda side_type: model.serves(side_type) and setup.lattice.dim in side_type.dims),
                key=f"boundary.{side_name(*key)}",
                remedy=model.combinations,
            )
    if not model.cuttable and (len(cracks) or coefficient is not None or setup.lattice.body is not None):
        given = "crack" if len(cracks) else "coefficient" if coefficient is not None else "lattice.body"
        raise InputError(
            "bonds of this model cannot be cut or weakened one by one",
            value=model.title,
            key=given,
            remedy="leave it out" + ", or a material of bonds, states or correspondence" * model.mechanical,
        )
    if not model.bonds and (coefficient is not None or any(crack.factor for crack in cracks)):
        raise InputError(
            "bonds whose forces follow from states of the nodes cannot be weakened one by one",
            value=model.title,
            key="crack.factor" if coefficient is None else "coefficient",
            remedy="cracks that cut bonds wholly, without a factor"
            if coefficient is None
            else "leave it out; the moduli and the density of the model may vary from node to node",
        )
    if model.dissolution is not None and coefficient is not None:
        raise InputError("the phases are the coefficient of a Corrosion", key="coefficient", remedy="leave it out")
    if len(setup.specimens) and model.dissolution is None:
        raise InputError(
            "only a Corrosion has specimens", value=type(model).__name__, key="specimens", remedy="Corrosion(...)"
        )
    if len(setup.loads) and not model.mechanical:
        raise InputError(
            "loads act on an elastic medium",
            value=type(model).__name__,
            key="load",
            remedy="a source, or a condition on a side",
        )
    if model.bond_law is not None:
        _check_bonds(setup)
    if model.stiffens_surfaces:
        _check_surface(setup, sides)
    if isinstance(model.integrator, ModifiedEquation):
        _check_modified_equation(setup, sides)
    if model.attenuation is not None:
        _check_attenuation(setup, sides)


def _refuse_sides(
    sides: Sides, model: LatticeModel, assumption: Assumption, what: str, value: object, remedy: str = "LatticePML"
) -> None:
    """Refuse sides that assume what does not hold."""
    for key, side in sides.items():
        if assumption in side.assumes:
            raise InputError(
                f"{type(side).__name__} does not support {what}",
                value=value,
                key=f"boundary.{side_name(*key)}",
                limit=names(lambda other: assumption not in other.assumes and model.serves(other)),
                remedy=remedy,
            )


def _check_attenuation(setup: Setup, sides: Sides) -> None:
    """Refuse sides and incident waves that are made for a medium without losses, bonds with a law of their own,
    energies of regions and reactions, and single precision, in which forces are differences of values that have lost
    their digits.
    """
    sources = zip(keys("source", setup.sources), setup.sources, strict=True)
    law = "bonds that neither break nor have a law of their own, without corrected surfaces and thermal loads"
    reaction = bool(np.any(setup.model.medium(setup.lattice.spacing, setup.lattice.dim).reaction))
    refused: list[tuple[bool, str, object, str]] = [
        (setup.model.bond_law is not None, "model", setup.model.title, law),
        (setup.balance and setup.model.by_region, "balance", True, "leave it out, or one quality everywhere"),
        (setup.balance and reaction, "balance", True, "leave it out, or the reaction"),
        (setup.dtype != "float64", "run.dtype", setup.dtype, 'dtype = "float64"'),
        *((isinstance(one, Incident), key, type(one).__name__, "a source, or initial data") for key, one in sources),
    ]
    for place, side in sides.items():
        refused.append(
            ("no losses" in side.assumes, f"boundary.{side_name(*place)}", type(side).__name__, "LatticePML")
        )
    for given, key, value, remedy in refused:
        if given:
            raise InputError("not available in a medium with attenuation", value=value, key=key, remedy=remedy)


def check_lossless(model: LatticeModel, key: str, remedy: str) -> None:
    """Refuse what follows from the forces of a medium without attenuation."""
    if model.attenuation is not None:
        raise InputError("not available in a medium with attenuation", value=model.attenuation, key=key, remedy=remedy)


def _check_modified_equation(setup: Setup, sides: Sides) -> None:
    """Refuse what the modified equation does not support: it squares the operator, so this must be linear and the same
    in all steps, and what acts on nodes or increments once per step has no place between its stages.
    """
    model = setup.model
    linear = 'bonds that neither break nor have a law of their own, or integrator = "verlet"'
    refused: list[tuple[bool, str, object, str]] = [
        (model.bond_law is not None, "model", model.title, linear),
        (bool(model.damping or model.drag), "model.damping", model.damping, 'integrator = "verlet"'),
        (model.attenuation is not None, "model.attenuation", model.attenuation, 'integrator = "verlet"'),
        (model.of_temperature is not None, "model", model.title, 'integrator = "verlet"'),
        (len(setup.constraints) > 0, "constraint", len(setup.constraints), 'Fixed sides, or integrator = "verlet"'),
        (setup.balance, "balance", True, 'leave it out, or integrator = "verlet"'),
    ]
    _refuse_sides(sides, model, "one stage", "the modified equation", model.integrator.name)
    for given, key, value, remedy in refused:
        if given:
            raise InputError(
                "the modified equation serves linear waves without damping", value=value, key=key, remedy=remedy
            )


def _check_surface(setup: Setup, sides: Sides) -> None:
    """Refuse what surfaces whose bonds are stiffer do not support: weak bonds, waves that come in with what a plain
    surface reflects, and conditions that follow from the bonds of a plain one.
    """
    free = [key for key, side in sides.items() if not side.bonded]
    closing = [f"boundary.{side_name(*key)}" for key, side in sides.items() if side.closing or side.exact]
    incident = bool(free) and any(isinstance(source, Incident) for source in setup.sources)
    refused = [
        (any(crack.factor for crack in setup.cracks), "crack.factor", "leave it out, or surface"),
        (setup.coefficient is not None, "coefficient", "leave it out, or moduli that vary"),
        (incident, "incident", "fh.surface_factor on young, or a source"),
        (bool(closing), next(iter(closing), ""), "LatticePML"),
    ]
    for given, key, remedy in refused:
        if given:
            raise InputError(
                "corrected surfaces have no such bonds, waves or sides beside them",
                value='surface = "energy"',
                key=key,
                remedy=remedy,
            )


def _check_bonds(setup: Setup) -> None:
    """Refuse what bonds that are nonlinear or break do not support."""
    if setup.rim == "fixed":
        raise InputError(
            "bonds that are nonlinear or break have no fixed surface",
            value=setup.rim,
            key="rim",
            remedy='rim="free" and Prescribed nodes along it, or Fixed sides',
        )
    if any(crack.factor for crack in setup.cracks):
        raise InputError(
            "bonds that are nonlinear or break are whole or cut", key="crack.factor", limit=0, remedy="leave it out"
        )


def check_variation(model: LatticeModel, sides: Sides, variation: Variation, stencil: Stencil) -> None:
    """Refuse sides that continue the medium with a single density if the density varies, and a medium that drifts if
    anything varies.
    """
    if stencil.drifting and (variation.squared_speed is not None or variation.density is not None):
        raise InputError(
            "a medium that drifts is uniform",
            value="values that vary",
            key="model",
            limit="constants, and no coefficient",
            remedy="numbers, or a stencil with equal weights at k and -k",
        )
    if variation.density is not None:
        _refuse_sides(sides, model, "one density", "a density that varies", "values that vary")


def check_entrances(setup: Setup, sides: Sides, stencil: Stencil) -> None:
    """Refuse a material or body that varies along the normal within one reach of a side whose nodes stretch
    derivatives: the nodes just before it take part in the absorption.
    """
    stretched = [key for key, boundary in sides.items() if boundary.derivatives]
    if not stretched:
        return
    exists = np.ones(setup.lattice.shape, bool) if setup.lattice.existing is None else setup.lattice.existing
    felt = {name: values for name, values in constants_of(setup).items() if name in setup.model.uneven}
    medium = {
        "lattice.body": exists,
        **{f"model.{name}": np.where(exists, constant, 0.0) for name, constant in felt.items()},
    }
    for (name, values), (axis, side) in itertools.product(medium.items(), stretched):
        last = np.moveaxis(values, axis, 0)[::-side][: stencil.reach[axis] + 1].reshape(stencil.reach[axis] + 1, -1)
        most = int(np.ptp(last.astype(float), axis=0).argmax())
        if (last[:, most] != last[0, most]).any():
            raise InputError(
                f"varies along {AXES[axis]} within one reach of {side_name(axis, side)}, whose layer stretches "
                "derivatives",
                value=f"{shown(last[:, most])} from the edge inwards",
                limit=f"constant over the last {len(last)} nodes",
                key=name,
                remedy="enlarge the near field, or values that do not change along the normal there",
            )


def check_stencil(setup: Setup, sides: Sides, stencil: Stencil) -> None:
    """Refuse what fields of several components, media with a reaction, and integrators with outline conditions do not
    support, and a near field thinner than the stencil, except along periodic axes, where that may wrap around.
    """
    if stencil.components > 1:
        _check_vector(setup, sides)
    if stencil.components not in (1, stencil.dim) and any(isinstance(source, Incident) for source in setup.sources):
        raise InputError(
            "incident waves are available for scalar and vector fields",
            value=f"{stencil.components} components",
            limit=f"1 or {stencil.dim}",
            key="incident",
            remedy="a source, or initial data",
        )
    elif not (stencil.weights > 0).any() and not stencil.strongest_reaction:
        raise InputError(
            "no weight of the stencil is positive: nothing draws a node to its neighbours, and what moves grows",
            value=f"weights from {stencil.weights.min():g} to {stencil.weights.max():g}",
            limit="> 0 for some",
            key="model.operator",
            remedy="positive weights for an operator such as a second derivative",
        )
    if stencil.strongest_reaction:
        _check_reaction(setup, sides, stencil)
    if stencil.drifting:
        _check_drift(setup, sides, stencil)
    if stencil.accuracy > 2:
        _check_faces(setup, sides, stencil.accuracy)
    _check_closing(setup, sides)
    for axis, (n, m) in enumerate(zip(setup.lattice.shape, stencil.reach, strict=True)):
        if n < 2 * m + 1 and not sides[axis, -1].periodic and not all(sides[axis, side].image for side in (-1, 1)):
            free = not (sides[axis, -1].bonded or sides[axis, 1].bonded)
            raise InputError(
                "the near field is thinner than the stencil",
                value=f"{n} nodes along {AXES[axis]}",
                limit=f">= {2 * m + 1}",
                key="lattice",
                remedy="enlarge the lattice or refine it"
                + (", or make what is thin the body of a wider lattice: lattice.body" if free else ""),
            )


def _check_faces(setup: Setup, sides: Sides, order: int) -> None:
    """Refuse faces at which the medium ends where differences are of an order above 2: those that lack bonds there are
    of the first order only.
    """
    free = [f"boundary.{side_name(*key)}" for key, side in sides.items() if not side.bonded]
    body = ["lattice.body"] if setup.lattice.body is not None and setup.rim == "free" else []
    for key in [*free, *body, *(["crack"] if setup.cracks else [])]:
        raise InputError(
            "central differences of a higher order have no bonds that may be absent: they need a medium that does not "
            "end",
            value=f"order {order}",
            limit="order 2 beside free sides, bodies and cracks",
            key=key,
            remedy='order = 2, or a kernel; a side may be absorbing, fixed or periodic, the rim of a body "fixed"',
        )


def check_repeats(setup: Setup, sides: Sides, stencil: Stencil) -> None:
    """Refuse a crack across a periodic side that does not re-enter through the opposite one: a bond across that side
    must be cut at both of its ends.
    """
    lattice, around = setup.lattice, sorted({axis for (axis, _), side in sides.items() if side.cracks == "repeat"})
    shape = np.array(lattice.shape)
    for crack in setup.cracks:
        low, high = crack.cut.bounds()
        if not any(low[a] < lattice.lower[a] or high[a] > lattice.upper[a] for a in around):
            continue
        nodes, bonds = cut_bonds(crack.cut, lattice.lower, lattice.spacing, lattice.shape, stencil.offsets)
        ends = nodes + stencil.offsets[bonds]
        beyond = (ends < 0) | (ends >= shape)
        ends[:, around] %= shape[around]
        across = beyond[:, around].any(1) & ((ends >= 0) & (ends < shape)).all(1)
        cut_ahead = np.concatenate([nodes, stencil.offsets[bonds]], 1)
        back = np.concatenate([ends, -stencil.offsets[bonds]], 1)[across]
        if len(np.unique(np.concatenate([cut_ahead, back]), axis=0)) > len(cut_ahead):
            raise InputError(
                "a crack crosses a side that cannot continue it: what leaves through a periodic side comes in "
                "through the opposite one",
                value=[b.tolist() for b in crack.cut.bounds()],
                limit=f"{lattice.lower.tolist()} to {lattice.upper.tolist()}",
                key="crack",
                remedy="a crack that continues beyond both sides, by the reach of the bonds, or ends inside",
            )


def _check_vector(setup: Setup, sides: Sides) -> None:
    """Refuse what fields of several components do not support."""
    name = type(setup.model).__name__
    for i, condition in enumerate(setup.constraints):
        if not isinstance(condition, Prescribed):
            raise InputError(
                f"thermal conditions are for scalar fields, not for {name}",
                value=type(condition).__name__,
                limit="Prescribed",
                key=f"constraint[{i}]",
                remedy="prescribe displacements or velocities, or load a free side",
            )
    if setup.background != 0:
        raise InputError(
            "the background of a vector field is zero", value=setup.background, key="background", remedy="leave it out"
        )
    for key, boundary in sides.items():
        if "one component" in boundary.assumes or boundary.held:
            raise InputError(
                f"{name} has no such side",
                value=repr(boundary),
                key=f"boundary.{side_name(*key)}",
                limit="LatticePML, Extended, Sponge, Fixed(0), Free, Periodic",
                remedy="Prescribed nodes beside a Free side, where it is to have other values",
            )


def _check_reaction(setup: Setup, sides: Sides, stencil: Stencil) -> None:
    """Refuse what a medium with a reaction does not support."""
    model, grows = setup.model, not np.ndim(stencil.reaction) and stencil.reaction < 0
    reaction = (-1 if grows else 1) * stencil.strongest_reaction
    value = f"reaction {reaction * model.coefficient / setup.lattice.spacing**2:g}"
    for key, boundary in sides.items():
        if grows and boundary.endless:
            raise InputError(
                f"{type(boundary).__name__} continues a medium in which what is small beyond the side grows, too",
                value=value,
                key=f"boundary.{side_name(*key)}",
                limit="a reaction >= 0 beside sides that absorb",
                remedy="Fixed, Free or Periodic, far enough away",
            )
    _refuse_sides(sides, model, "no reaction", "media with a reaction", value)
    if model.dissolution is not None:
        raise InputError("metal that dissolves has no reaction", value=value, key="model", limit=0)
    if any(isinstance(source, Incident) for source in setup.sources):
        raise InputError(
            "an incident wave travels through a medium without a reaction",
            value=value,
            key="incident",
            limit=0,
            remedy="a source, or initial data",
        )


def _check_drift(setup: Setup, sides: Sides, stencil: Stencil) -> None:
    """Refuse what a medium that drifts does not support, and one whose short waves grow however small the step is."""
    model, words = setup.model, "weights that differ ahead of a node and behind it"
    if not isinstance(model.integrator, Euler):
        raise InputError(
            f"{model.title} with {words} is not available with this integrator",
            value=model.integrator.name,
            limit="diffusion and heat by forward Euler",
            key="model",
            remedy="weights that are equal at k and -k for waves; integrator = euler for diffusion",
        )
    if not np.isfinite(stencil.symbol_maximum):
        raise InputError(
            "some waves grow at every time step: they are carried, but nothing spreads them",
            value=stencil.weights.tolist(),
            limit="sum_k w_k (1 - cos k angle) > 0 for all angles but zero",
            key="model.operator",
            remedy="larger weights for the diffusion, or differences that lie upstream",
        )
    _refuse_sides(sides, model, "no drift", words, stencil.weights.tolist(), "Exact")
    conditions = [condition for condition in setup.constraints if not isinstance(condition, Prescribed)]
    for name, given in (
        ("crack", len(setup.cracks)),
        ("lattice.body", setup.lattice.body is not None),
        ("constraint", len(conditions)),
        ("model", bool(model.follows or model.dissolution)),
    ):
        if given:
            raise InputError(
                f"no bond is cut, stronger or weaker than others in a medium with {words}",
                key=name,
                remedy="leave it out, or a stencil with equal weights at k and -k",
            )


def _check_closing(setup: Setup, sides: Sides) -> None:
    """Refuse conditions along an outline unless the integrator has one stage and a window has the same on all sides."""
    closing = [b for b in sides.values() if b.closing]
    if not closing:
        return
    name, integrator = type(closing[0]).__name__, setup.model.integrator
    if not isinstance(integrator, Euler | Verlet):
        raise InputError(
            f"{name} needs an integrator of one stage per step",
            value=integrator.name,
            key="model.integrator",
            limit="forward Euler, velocity Verlet",
            remedy='integrator="euler", or LatticePML',
        )
    if setup.lattice.window is not None and (len(closing) < len(sides) or len({repr(b) for b in closing}) > 1):
        raise InputError(
            f"{name} closes a window along its outline, all around",
            key="boundary",
            remedy="the same condition on all sides",
        )


def closed_window(setup: Setup, sides: Sides) -> np.ndarray | None:
    """Return the nodes of a window that a condition along its outline closes; None if there is none."""
    closes = setup.lattice.window is not None and any(b.closing for b in sides.values())
    return setup.lattice.framed if closes else None
