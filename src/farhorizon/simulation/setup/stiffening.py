"""Increase of the largest frequency of a solid where bonds are absent or moduli vary, over that of a uniform one."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh_tridiagonal

from farhorizon.medium.random_constants import uniform
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup

# Lanczos iteration for the largest squared frequency: largest number of applications of the operator, and relative
# residual, a bound of the error, at which it ends; small enough that a crack and its mirror image have the same step,
# that of the faster of two tips
_ITERATIONS, _RESIDUAL = 400, 1e-6
# smallest relative excess over a known rate that is certainly found; it is always added to the rate
_UNSEEN = 3e-4
# margin added to the excess over the medium: a fraction of the excess, and at most a fraction of the medium's rate.
# Waves along a crack or a free face oscillate faster the longer it is, and the layers that are chosen may be thicker
# than those of the trial. Measured with near fields of 13 nodes and layers of 12 and of 58: at most a third of the
# excess and 0.013 of the rate
_MORE, _MOST = 0.5, 0.02


def stiffening(near: NearField, grid: Grid, team: ProcessGroup, counted: float = 1.0) -> float:
    """Return the largest squared frequency over that of the medium with all its bonds, above 1 where states lack bonds,
    moduli vary or bonds near surfaces are stiffer; the near field's rate already includes a factor `counted`.
    """
    unlike = team.any(bool(grid.engine.absent.count) or near.variation.moduli is not None)
    if not unlike or not (grid.engine.passes or near.model.stiffens_surfaces):
        return 1.0
    intact = near.rate_limit - near.closing_rate - (counted - 1) * near.medium_rate
    return _with_margin(largest_rate(grid, team, intact) / intact - 1)


def least_stiffening(setup: Setup) -> float:
    """Return the smallest `stiffening` of a set-up: its value if nothing stiffer than the medium is found."""
    return _with_margin(0.0) if _may_stiffen(setup) else 1.0


def _with_margin(excess: float) -> float:
    """Return the stiffening for a relative excess over the medium's rate, which is negative if there is none."""
    excess = max(excess, _UNSEEN)
    return float(f"{1 + excess + min(_MORE * excess, _MOST):.7g}")  # so that the order of sums does not affect the step


def _may_stiffen(setup: Setup) -> bool:
    """Whether nodes have states that may lack bonds or have other moduli than the medium, or stiffer bonds."""
    if setup.model.bonds and not setup.model.stiffens_surfaces:
        return False
    cut = bool(setup.cracks) or not all(side.bonded and not side.closing for side in setup.sides.values())
    cut |= setup.lattice.body is not None and setup.rim == "free"
    return cut or bool(setup.model.varying) or setup.coefficient is not None


def largest_rate(grid: Grid, team: ProcessGroup, known: float = 0.0) -> float:
    """Return the largest squared frequency of all nodes without the effect of layers, over all processes; it need not
    be accurate below the rate `known`.

    The operator is symmetric, so Lanczos' method finds it, from below; nodes that never move are at zero.
    """
    engine, layout = grid.engine, grid.layout
    places = layout.box.node_indices()
    exists = engine.get("exists", places)
    nodes = engine.all_components(places[exists]).reshape(engine.components, -1)
    root = np.sqrt(engine.mobility[nodes] if engine.mobility.size > 1 else engine.mobility)
    level = engine.level()

    def applied(values: np.ndarray) -> np.ndarray:
        level[nodes] = root * values
        engine.complete(level)
        return -root * engine.apply_core(level, again=True)[nodes]

    def product(left: np.ndarray, right: np.ndarray) -> float:
        return float(team.summed(np.array([(left * right).sum()]))[0])

    values, enough = _noise(grid, team, places[exists])
    values /= np.sqrt(product(values, values))
    before, diagonal, beside = np.zeros_like(values), [], [0.0]
    unit = 1.0
    for count in range(_ITERATIONS):
        image = applied(values)
        if count == 0:  # a power of two, as a unit of rates whose squares neither overflow nor underflow
            unit = float(np.ldexp(1.0, int(np.frexp(team.largest(float(np.abs(image).max(initial=0.0))))[1])))
        image /= unit
        diagonal.append(product(values, image))
        image -= diagonal[-1] * values + beside[-1] * before
        (rate,), vector = eigh_tridiagonal(diagonal, beside[1:], select="i", select_range=(count, count))
        beside.append(np.sqrt(product(image, image)))
        if beside[-1] * abs(vector[-1, 0]) <= _RESIDUAL * rate or (count >= enough and unit * rate <= known):
            break
        before, values = values, image / beside[-1]
    return float(unit * rate)


def _noise(grid: Grid, team: ProcessGroup, places: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the start vector of Lanczos' method, half of whose energy lies at nodes unlike the medium, and a number of
    applications: if no rate above the medium's has been found by then, the largest exceeds it by at most `_UNSEEN`.

    Modes faster than those of the medium are localised at these nodes: in noise spread over all nodes their fraction
    would decrease with the size of the box. For n unknowns, m applications miss at most (ln n / 4 m)^2 of the rate.
    """
    engine = grid.engine
    box, components = grid.layout.box, engine.components
    first = [n - low for n, low in zip(grid.first, grid.layout.low, strict=True)]
    at = [index + n for index, n in zip(box.coordinates(places).T, first, strict=True)]
    # the value of a node depends on its place alone, whichever process has it
    values = np.stack([uniform(seed, *at) - 0.5 for seed in range(components)])
    unlike = _unlike(grid, team, places)
    some, all_nodes = team.summed(np.array([unlike.sum(), len(places)], float))
    if 0 < some < all_nodes:
        values[:, unlike] *= np.sqrt((all_nodes - some) / some)
        numbers = 2 * components * some
    else:
        numbers = components * all_nodes
    return values, int(np.ceil(np.log(numbers) / (4 * np.sqrt(_UNSEEN))))


def _unlike(grid: Grid, team: ProcessGroup, places: np.ndarray) -> np.ndarray:
    """Return which nodes have states that lack bonds, a neighbour along some axis with other moduli, or a bond that is
    stiffer.
    """
    engine, passes = grid.engine, grid.engine.passes
    unlike = np.isin(places, engine.absent.stiffened[0])
    if passes is None:  # without states no absent bond makes another one stiffer
        return unlike
    unlike |= np.isin(places, engine.get("gradient_pass.sweep.law.nodes"))
    if team.any(bool(engine.get("gradient_pass.sweep.law.local").size)):
        near = grid.layout.near.node_indices()
        for modulus in passes.moduli_at(near.ravel()).T:
            moduli = engine.spread(modulus.reshape(near.shape), jointly=True)
            for step, reach in zip(grid.layout.box.stride, grid.layout.reach, strict=True):
                for neighbour in (places - step, places + step) if reach else ():
                    unlike |= moduli[neighbour] != moduli[places]
    return unlike
