"""Stress intensity factors of stationary cracks, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.fracture.interaction import InteractionDomain
from farhorizon.analysis.fracture.near_tip import NearTip
from farhorizon.arguments import Points, Unit
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Cut, Polyline
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import Arrays, RecordRequest, RowRecorder, Window
from farhorizon.simulation.setup.compatibility import check_lossless
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup

_PART = 0.75  # radius of the larger circle, relative to the distance of the next corner of a crack
_UNEVEN = 1e-9  # relative tolerance


class StressIntensity(RowRecorder):
    r"""Stress intensity factors over time, from the interaction integral; passed to a run in ``observe=[...]``.

    K of a stationary crack is a sum over the nodes around its tip, because the interaction integral is linear in the
    field and the force that the bonds exert on a node is density times acceleration minus load. It is therefore valid
    for waves and for loads on the faces, and it does not depend on the circles; see
    `farhorizon.analysis.fracture.interaction`.

    Parameters
    ----------
    tips : array_like, shape (n, 2), optional
        Ends of cracks of the run, to within half a spacing; unless given, all that lie in the near field.
    radii : (float, float), optional
        Inner and outer circle: the gradient of the field is evaluated between them, and each crack must be straight and
        alone within them. Unless given, as large as possible, with the smaller radius half the larger one.
    every : int
        Steps from one record to the next.
    name : str
        Name that distinguishes several of them in one run.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        The tips.
    ahead : ndarray, shape (n, 2)
        The directions in which the cracks would advance.
    domains : list of InteractionDomain
    times : ndarray, shape (rows,)
    data : dict of str to ndarray
        "K_I" and "K_II" for elastic media (K_I opens a crack; K_II moves the face to the left of the direction of
        advance in that direction), "K_III" for scalar waves, whose modulus is the squared speed; "G", the energy that
        new crack area would release, by Irwin's relation. Each of shape (rows, n).

    Raises
    ------
    InputError
        When the simulation is created: no crack tip, other than two dimensions, bonds that are nonlinear or break,
        cracks that open later or only weaken bonds, a medium that varies around a tip, circles within the horizon of
        the tip, that extend beyond the near field or the box of an incident wave, or that a crack crosses twice.

    Notes
    -----
    Yau, Wang and Corten (1980), J. Appl. Mech. 47, 335. On a lattice with a horizon of m spacings, the error is
    proportional to the spacing, like that of the position of the tip between the nodes.

    Examples
    --------
    >>> import farhorizon as fh
    >>> intensity = fh.StressIntensity([(4.0, 0.0)])
    >>> lattice = fh.Lattice(0.5, (-8.25, -6.25), (8.25, 6.25))
    >>> pull = fh.Source("0.5*y*exp(-y**2 - x**2/4)", fh.Step(4.0))
    >>> crack = [(-4.0, 0.0), (4.0, 0.0)]
    >>> model = fh.Wave(fh.Kernel(1.0))
    >>> sim = fh.Simulation(lattice, model, sources=[pull], cracks=[crack], observe=[intensity])
    >>> _ = sim.run(until=12.0)
    >>> intensity.data["K_III"].shape == (sim.step_count + 1, 1)
    True
    """

    shared = True

    def __init__(
        self,
        tips: Points | None = None,
        radii: Annotated[tuple[float, float] | None, Unit("m")] = None,
        every: int = 1,
        name: str = "stress_intensity",
    ) -> None:
        super().__init__(name)
        self.tips = None if tips is None else np.atleast_2d(kinds.array(tips, "stress_intensity.tips"))
        if self.tips is not None and (self.tips.shape[1:] != (2,) or not len(self.tips)):
            raise InputError(
                "tips are points of the plane", value=self.tips.shape, limit="(n, 2)", key="stress_intensity.tips"
            )
        self.radii = None
        if radii is not None:
            inner, outer = kinds.array(radii, "stress_intensity.radii", shape=(2,))
            self.radii = float(inner), float(outer)
        self.every = kinds.integer(every, "stress_intensity.every", least=1)
        self.points = self.ahead = np.zeros((0, 2))
        self.domains: list[InteractionDomain] = []

    def __repr__(self) -> str:
        return f"StressIntensity({'all' if self.tips is None else len(self.tips)} tips, every={self.every})"

    # --- what was recorded -------------------------------------------------------------------------------------

    @property
    def data(self) -> dict[str, np.ndarray]:
        """Stress intensity factors and energy release rates, by name."""
        if not self.domains:
            return {}
        medium, rows = self.domains[0].medium, super().data["rows"]
        intensities = {mode: rows[..., number] for number, mode in enumerate(medium.modes)}
        return {**intensities, "G": medium.release(rows)}

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near = parts.whole.near
        _check_medium(setup, near)
        check_lossless(near.model, "stress_intensity", "Receivers beside the tip")
        ends = _ends([crack.cut for crack in setup.cracks], near)
        chosen = range(len(ends)) if self.tips is None else [_nearest(tip, ends, near) for tip in self.tips]
        self.points = np.array([ends[number][0] for number in chosen])
        self.ahead = np.array([ends[number][1] for number in chosen])
        cuts = [crack.cut for crack in setup.cracks]
        edges = _edges(parts)
        self.domains = [
            InteractionDomain(
                near.lattice, tip, ahead, _circles(tip, self.radii, cuts, near, edges), cuts, _medium_at(parts, tip)
            )
            for tip, ahead in zip(self.points, self.ahead, strict=True)
        ]
        for domain in self.domains:
            _check_even(parts, domain)
        source_terms = [(space, time) for space, time in parts.active_terms if space is not None]
        self._times = [time for _, time in source_terms]
        pairs = [_weights(domain, parts, [space for space, _ in source_terms]) for domain in self.domains]
        self._faces = np.array([of_loads for _, of_loads in pairs])  # (tips, loads, modes)
        weights = np.array([of_nodes for of_nodes, _ in pairs])  # (tips, modes, nodes, components)
        nodes = np.flatnonzero(weights.any((0, 1, 3)))
        self._table, self.dt = weights[:, :, nodes], near.dt
        return RecordRequest(nodes, (), self.every)

    def rows(self, window: Window) -> Arrays:
        count, (states,) = len(window.steps), window.values
        loads = np.array([[time(self.dt * n) for time in self._times] for n in window.steps]).reshape(
            count, len(self._times)
        )
        # step by step: the rounding of a sum over all depends on how many are added at once
        intensities = np.zeros((count, *self._table.shape[:2]))
        for row, (state, load) in enumerate(zip(states, loads, strict=True)):
            intensities[row] = np.einsum("tknc,nc->tk", self._table, state)
            intensities[row] += np.einsum("tjk,j->tk", self._faces, load)
        return {"rows": intensities}


def _weights(domain: InteractionDomain, parts: RunParts, loads: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights with which displacements enter K, shape (modes, nodes, components), where the force on a node
    is what its bonds exert, and the contributions of loads on the faces per unit of their amplitude, shape (loads,
    modes).

    The weights of forces are singular at the tip, where sums over nodes approach integrals only like the root of the
    spacing. The loads are therefore replaced: a linear field is added, which has no intensity, and whose tractions on
    the faces are those of the load.
    """
    near, engine, grid, team = parts.whole.near, parts.grid.engine, parts.grid, parts.whole.team
    lattice, components = near.lattice, engine.components
    own_nodes = np.flatnonzero(parts.near.lattice.own(np.arange(int(np.prod(lattice.shape))))[0])
    is_loaded = np.abs(domain.loaded).any((0, 2))
    loaded_nodes = domain.nodes[is_loaded]
    linear = np.eye(2 * components).reshape(-1, components, 2)  # gradients of linear fields

    def pulled(values: np.ndarray) -> np.ndarray:
        """Return the forces that the bonds exert on the nodes for a field of shape (nodes, components)."""
        level = engine.level()
        level[grid.indices] = values[own_nodes].T.reshape(grid.indices.shape)
        if team:
            engine.complete(level)
        forces = np.asarray(engine.apply_core(level)[grid.indices], float).reshape(components, -1).T
        return team.completed(forces, own_nodes, len(values), 0)

    grid_points = np.stack(lattice.coordinates(), axis=-1).reshape(-1, 2)
    weights = np.zeros((len(grid_points), len(domain.modes), components))
    weights[domain.nodes] += domain.static.swapaxes(0, 1)
    for k, loaded in enumerate(domain.loaded):  # the operator is symmetric
        on_loaded = np.zeros((len(grid_points), components))
        on_loaded[domain.nodes] = loaded / near.model.source_factor
        weights[:, k] += pulled(on_loaded)
    at_tip = np.linalg.norm(grid_points[loaded_nodes] - domain.tip, axis=1)
    root_density = np.sqrt(1 / np.maximum(at_tip, lattice.spacing / 2))[:, None]
    forces = np.array([pulled((grid_points - domain.tip) @ gradient.T)[loaded_nodes] for gradient in linear])
    table = (forces / near.model.source_factor * root_density).reshape(len(linear), -1).T
    inside, own_loaded = parts.near.lattice.own(loaded_nodes)
    on_nodes = [np.asarray(load, float).reshape(components, -1).T[own_loaded] for load in loads]
    load_columns = [
        (team.completed(load, np.flatnonzero(inside), len(loaded_nodes), 0) * root_density).ravel() for load in on_nodes
    ]
    columns = np.array(load_columns).reshape(len(loads), len(table)).T
    fitted = np.linalg.lstsq(table, columns, rcond=_UNEVEN)[0]  # (fields, loads)
    of_linear = np.einsum("nkc,mcb,nb->mk", weights, linear, grid_points - domain.tip)
    return weights.swapaxes(0, 1), fitted.T @ of_linear


def _check_medium(setup: Setup, near: NearField) -> None:
    """Raise InputError unless cracks are stationary in a medium of waves in the plane."""
    model, reason, remedy = near.model, None, ""
    if near.lattice.dim != 2:
        reason, remedy = "intensities are recorded in 2D only", "opening_intensity of the faces in 3D"
    elif model.order != 2 or model.moduli is None:
        reason, remedy = "only elastic media and scalar waves have stress intensity factors", "Elastic or Wave"
    elif model.bond_law is not None:
        reason = "bonds that are nonlinear or break move the tip, and heat has stresses of its own"
        remedy = "CrackTips, or linear bonds that stay"
    elif any(crack.opens or crack.factor for crack in setup.cracks):
        reason, remedy = "cracks that open later or carry something have no such field", "cracks from the start on"
    if reason is not None:
        raise InputError(reason, value=model.title, key="stress_intensity", remedy=remedy)


def _ends(cuts: Sequence[Cut], near: NearField) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the free tips in the near field, each with the direction in which it would advance."""
    lattice, tips = near.lattice, []
    for points in (cut.points for cut in cuts if isinstance(cut, Polyline)):
        if (points[0] == points[-1]).all():
            continue
        for tip, before in ((points[0], points[1]), (points[-1], points[-2])):
            if (tip >= lattice.lower).all() and (tip <= lattice.upper).all():
                tips.append((tip, (tip - before) / np.linalg.norm(tip - before)))
    if not tips:
        raise InputError(
            "no crack has a tip in the near field", key="stress_intensity", remedy="cracks=[[(x0, y0), (x1, y1)]]"
        )
    return tips


def _nearest(tip: np.ndarray, ends: Sequence[tuple[np.ndarray, np.ndarray]], near: NearField) -> int:
    """Return the number of the tip at a given point."""
    distances = [float(np.linalg.norm(tip - end)) for end, _ in ends]
    if min(distances) > near.lattice.spacing / 2:
        raise InputError(
            "no crack ends there",
            value=tip.tolist(),
            limit=", ".join(str(end.round(12).tolist()) for end, _ in ends),
            key="stress_intensity.tips",
        )
    return int(np.argmin(distances))


def _circles(
    tip: np.ndarray,
    given: tuple[float, float] | None,
    cuts: Sequence[Cut],
    near: NearField,
    edges: tuple[np.ndarray, np.ndarray],
) -> tuple[float, float]:
    """Return the given radii, or that of the largest circle around a tip that needs no nodes beyond the near field and
    keeps away from other corners of cracks, and half of it, or the horizon if that is larger; raises InputError if the
    circles come within the horizon of the tip or of the edge.
    """
    lattice = near.lattice
    room = float(min((tip - edges[0]).min(), (edges[1] - tip).min()))
    reach = max(near.stencil.reach) * lattice.spacing
    corners = np.concatenate([cut.points for cut in cuts if isinstance(cut, Polyline)])
    distances = np.linalg.norm(corners - tip, axis=1)
    widest = min(room - reach, _PART * float(distances[distances > 0].min()))
    inner, outer = given or (max(widest / 2, reach), widest)
    if inner < reach * (1 - _UNEVEN) or outer > room - reach * (1 - _UNEVEN):
        raise InputError(
            "the circles around the tip come within the horizon of the tip, or of the edge of the near field, beyond "
            "which the layer is, or of an incident wave's box",
            value=[inner, outer],
            limit=f"{reach:.6g} to {room - reach:.6g}",
            key="stress_intensity.radii",
            remedy="a larger near field, a finer lattice, or a longer crack",
        )
    return inner, outer


def _edges(parts: RunParts) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box in which the field is the total one: the near field, and within it the boxes of
    incident waves, outside which it is the scattered one.
    """
    lattice, regions = parts.whole.near.lattice, [incident.region for incident in parts.incident]
    lower = np.max([lattice.lower, *(lattice.lower + lattice.spacing * region.first for region in regions)], axis=0)
    upper = np.min([lattice.upper, *(lattice.lower + lattice.spacing * region.last for region in regions)], axis=0)
    return lower, upper


def _medium_at(parts: RunParts, tip: np.ndarray) -> NearTip:
    """Return the near-tip fields for the medium around a tip."""
    lattice = parts.near.lattice.whole
    node = np.ravel_multi_index(lattice.index(tip), lattice.shape)
    lame, shear = parts.at(parts.near.lame, np.array([node]))[:, 0].tolist()
    return NearTip(lame, shear, antiplane=not parts.near.model.mechanical)


def _check_even(parts: RunParts, domain: InteractionDomain) -> None:
    """Refuse a domain in which the medium varies or ends."""
    factor = parts.at(parts.near.material, domain.nodes)  # nan where the medium ends or differs otherwise
    if parts.hides(domain.nodes).any() or not np.ptp(factor) <= _UNEVEN * factor.max():
        raise InputError(
            "the medium varies around the tip, or ends there",
            value=domain.tip.tolist(),
            key="stress_intensity.radii",
            remedy="smaller radii",
        )
