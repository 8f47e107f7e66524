"""Bonds that follow a law of their own stretch: nonlinear ones, and those that break.

In the margin of a near field, within one reach of sides that are not free, and outside the boxes of incident waves,
bonds cannot break, so that a crack that gets there stops.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from farhorizon.engine.bonds import steepest
from farhorizon.engine.engine import Zone
from farhorizon.engine.features.faces import energies_of_faces
from farhorizon.engine.features.thermal_strain import set_thermal_strain
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.incidence import Region
from farhorizon.medium.fracture import final_stretch
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import BondLaw
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.cuts import CutBonds
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Sides
from farhorizon.simulation.time.outer_loop import warn_once

_ROUNDING = 1e-9  # relative
_SHATTERS = 10.0  # a load whose first strain is this many times the critical stretch would break all bonds in its way


#: Note on the energy that a crack at rest takes (`benchmarks/at_rest.py`, and a double cantilever beam).
AT_REST = (
    "a crack at rest begins to grow at 1.05 to 1.37 times the fracture energy, depending on material and load, because "
    "its tip waits at each row of nodes: check the load at which yours starts by a finer lattice, or set calibrate = "
    '"static"'
)


@dataclass(frozen=True, eq=False)
class IntactMargin:
    """The bonds of the nodes in the margin."""

    nodes: np.ndarray  # of int, shape (n,); places of the nodes in a level
    corners: np.ndarray  # of int, shape (n, dim); their indices in the lattice
    bits: np.ndarray  # of uint64, shape (words, n); one bit per bond: set if it is present and ends in the near field
    distances: np.ndarray  # of int, shape (K,); offsets to the neighbours in a level
    bonds: np.ndarray  # shape (K, dim); bond vectors
    # largest ``|xi + eta|^2 / |xi|^2 - 1`` at which the weakest bonds would not break (linearised: ``2 xi . eta /
    # |xi|^2``)
    limit: float
    nonlinear: bool
    strength: np.ndarray  # limit at each place of a level relative to `limit`, or a single number
    every: int  # steps between two checks: a wave takes longer to cross the margin
    boxed: bool  # whether the margin includes what lies outside the boxes of incident waves

    def overstretched(self, level: np.ndarray) -> np.ndarray | None:
        """Return the index in the lattice of the node whose bond exceeds its limit most in a level of the engine; None
        if none does.
        """
        given = self.nodes, self.bits, self.distances, self.bonds, self.nonlinear, self.strength
        node, strain = steepest(level, *given)
        return self.corners[node] if strain > self.limit else None

    def warning(self, level: np.ndarray, lattice: Lattice) -> str | None:
        """Return a warning if a bond exceeds its limit; otherwise None."""
        node = self.overstretched(level)
        if node is None:
            return None
        place = (lattice.lower + lattice.spacing * node).round(9).tolist()
        return (
            f"bonds near {place} are stretched beyond the critical stretch where they cannot break, within one "
            f"reach of a side that is not free{' or outside the box of an incident wave' if self.boxed else ''}: a "
            "crack stops there, and what follows is not valid; enlarge the near field"
        )


class BreakableBonds:
    """Bonds of a near field on its grid that follow a law; the engine receives them whole and uncut.

    `regions` are the boxes of incident waves. The field is the total one inside them and the scattered one outside, so
    that bonds through their faces see a jump that is not in the solid, and bonds outside see only a part of the strain:
    neither can break.
    """

    def __init__(
        self,
        law: BondLaw,
        near: NearField,
        sides: Sides,
        grid: Grid,
        cuts: CutBonds,
        regions: Sequence[Region] = (),
        team: ProcessGroup = ALONE,
    ) -> None:
        self.law, self.near, self.sides, self.grid, self.cuts, self.team = law, near, sides, grid, cuts, team
        self.regions = regions
        self.critical_stretch = -team.largest(-float(self.critical_stretches.min()))  # of the weakest bonds of all
        if law.law is not None:
            lengths = near.lattice.spacing * np.linalg.norm(near.stencil.offsets, axis=1)
            for length in (lengths.min(), lengths.max()):
                law.law.check(near.dt, float(length))
        self.begin()
        self.families = self.left()  # number of bonds of each node, uncut; of the lattice's shape
        if law.fracture_energy is not None:
            cuts.notes.extend(self._calibration())

    def _calibration(self) -> list[str]:
        """Return notes on which cracks take the fracture energy, and on what others take."""
        law, found = self.law, f"bonds break at a critical stretch of {self.critical_stretch:.4g}, with which a crack "
        if law.energy_factor is None:
            return [AT_REST]
        if law.spent_by_running is None:
            return [
                found + "dissipates the fracture energy: found from cracks that ran through this lattice at 0.3 of the "
                "speed of Rayleigh waves",
                AT_REST,
            ]
        return [
            found + "at rest in a slowly pulled strip begins to grow at the fracture energy; one that runs at 0.3 of "
            f"the speed of Rayleigh waves dissipates {law.spent_by_running:.3g} of it"
        ]

    @cached_property
    def zone(self) -> Zone:
        """Where the law holds: one reach away from sides that are not free, for sides that extend the domain from their
        far ends, and inside the boxes of incident waves.
        """
        near, lead, margins = self.near, self.grid.lead, self.grid.margins
        lattice = near.lattice
        first, end = [0] * 3, [1] * 3
        onward = {(lead + axis, side) for (axis, side), b in self.sides.items() if b.periodic or b.shared}
        for axis, n in enumerate(lattice.shape):
            inset = {}
            for side in (-1, 1):
                boundary, more = self.sides[axis, side], margins[axis, side]
                apart = 0 if (lead + axis, side) in onward or not boundary.bonded else near.stencil.reach[axis]
                inset[side] = apart + (0 if boundary.extended else more)
            first[lead + axis] = inset[-1]
            end[lead + axis] = margins[axis, -1] + n + margins[axis, 1] - inset[1]
            for region in self.regions:
                low, high = region.along(axis, lattice)
                first[lead + axis] = max(first[lead + axis], margins[axis, -1] + low)
                end[lead + axis] = min(end[lead + axis], margins[axis, -1] + high)
                onward -= {(lead + axis, side) for side, face in ((-1, low >= 0), (1, high <= n)) if face}
            end[lead + axis] = max(first[lead + axis], end[lead + axis])
        return Zone((first[0], first[1], first[2]), (end[0], end[1], end[2]), onward)

    @property
    def may_break(self) -> bool:
        """Whether bonds can break at all."""
        return bool(np.isfinite(self.critical_stretch)) if self.law.law is None else self.law.law.breaks

    @property
    def extent(self) -> np.ndarray:
        """Nodes of the zone along the three axes."""
        return np.subtract(self.zone.end, self.zone.first)

    @cached_property
    def critical_stretches(self) -> np.ndarray:
        """At the nodes of this lattice, or a single number; a bond breaks at the smaller value of its two ends."""
        lattice, strength, factor = self.near.lattice, self.near.variation.strength, self.near.factor
        given = 1.0 if strength is None else strength, 1.0 if factor is None else factor
        return np.asarray(self.law.critical_stretch_on(lattice.spacing, lattice.dim, *given))

    @cached_property
    def final_stretches(self) -> np.ndarray:
        """For bonds that soften, the stretch at which nothing is left of them, at the nodes of this lattice or as a
        single number; raises InputError if they hold more than the fracture energy when they begin to soften.
        """
        law, near, onset = self.law, self.near, self.critical_stretches
        toughness = 1.0 if near.variation.toughness is None else near.variation.toughness
        bonds = near.lattice.spacing * near.stencil.offsets
        stiffness = law.bond_stiffness(near.stencil, near.lattice.spacing)
        with np.errstate(divide="ignore"):  # where there are no bonds
            energy = law.fracture_energy * toughness / (1.0 if near.factor is None else near.factor)
        final = np.asarray(final_stretch(bonds, stiffness, onset, energy))
        share = -self.team.largest(-float((final / onset).min()))
        if share < 1 - _ROUNDING:
            raise InputError(
                "bonds store more when they begin to soften than the fracture energy, so they would snap back",
                value=f"{share:.4g} of that",
                limit=">= 1",
                key="model.fracture_energy",
                remedy=f"a horizon of about {share:.2g} times this one, or a critical stretch of at most "
                f"{np.sqrt(share):.3g} times this one",
            )
        return np.maximum(final, onset)

    def _limits(self) -> tuple[float, np.ndarray | None, np.ndarray | None]:
        """Return the largest strain e at which no bond breaks, and relative to it the strengths of the nodes, None if
        all are equal: the largest strains, or, where a fracture energy is given and bonds differ in stiffness,
        energies, by which a bond's own stiffness decides; then also the stiffness of the nodes.
        """
        law, near = self.law, self.near
        if law.fracture_energy is not None and law.softening is None:
            energy, factor = (
                self._everywhere(1.0 if values is None else values) for values in (near.variation.strength, near.factor)
            )
            (least, _), (soft, stiff) = self._range(energy), self._range(factor)
            if soft < stiff:
                limit = law.critical_stretch_on(near.lattice.spacing, near.lattice.dim, least, stiff)
                strengths = energy * (stiff / least)
                return float(self._strain(limit)), self.grid.grown(strengths), self.grid.grown(factor)
        limits = self._strain(self.critical_stretches)
        least, most = self._range(limits)
        return least, None if least == most else self.grid.grown(self._everywhere(limits / least)), None

    def _strain(self, stretches: Any) -> Any:
        """Return the strain e at some stretches."""
        curved = self.law.nonlinear and np.isfinite(self.critical_stretch)
        return stretches * (2 + stretches) if curved else 2 * stretches

    def _range(self, values: np.ndarray) -> tuple[float, float]:
        """Return the smallest and the largest value on all processes."""
        of_all = self.team.gather((float(values.min()), float(values.max())))
        return min(low for low, _ in of_all), max(high for _, high in of_all)

    def _everywhere(self, values: Any) -> np.ndarray:
        """Return values at the nodes as an array, also if there is a single one for all."""
        return np.broadcast_to(values, self.near.lattice.shape)

    def begin(self) -> None:
        """Give the engine the law of the bonds, whole and uncut."""
        law, spacing = self.law, self.near.lattice.spacing
        limit, strength, stiffer = self._limits()
        engine = self.grid.engine
        count = len(engine.offsets)
        bonds, hard = self._bonds(), None
        stiffness = np.zeros(count) if bonds is None else law.bond_stiffness(bonds, spacing) / law.density
        if engine.passes is not None and self.near.factor is not None:
            hard = self.grid.grown(self.near.factor)
        ends = None if law.softening is None else self.grid.grown(self._everywhere(self.final_stretches))
        options: list[Any] = [law.contact, law.warm, law.softening, ends, hard, stiffer]
        if law.law is not None:
            options += [law.law.functions, law.law.numbers(self.near.dt)]
        engine.bonds.set(stiffness, spacing, self.zone, law.nonlinear, limit, strength, *options)
        if law.warm:
            set_thermal_strain(engine, spacing)
        self.cuts.cut(())

    def _bonds(self) -> Stencil | None:
        """Return the bonds that follow the law, next to states those that close; None if they only break."""
        near = self.near
        states = (
            None if self.grid.engine.passes is None else near.model.force_states(near.lattice.spacing, near.lattice.dim)
        )
        if states is None:
            return near.stencil
        return None if states.closed is None else Stencil(states.offsets, states.closed)

    def left(self) -> np.ndarray:
        """Return the number of bonds that each node of the near field has left; shape of the lattice."""
        return self.grid.engine.bonds.left[self.grid.near].reshape(self.near.lattice.shape)

    @property
    def damage(self) -> np.ndarray:
        """Fraction of the bonds of each node that are cut or broken; bonds that soften count by the stiffness that they
        have lost.
        """
        return 1 - self.left() / np.maximum(self.families, 1)

    def loose(self) -> int:
        """Return the number of nodes of the near field that have lost all their bonds."""
        return int(((self.left() == 0) & (self.families > 0)).sum())

    def strain_energy(self, cold: bool = False) -> float:
        """Return the strain energy of the bonds of the near field, next to states that of bonds that close; bonds
        across its edge count half, those to a held side in full. If `cold`, thermal strains are not subtracted.
        """
        lattice, lead = self.near.lattice, self.grid.lead
        first = [0] * lead + [self.grid.margins[a, -1] for a in range(lattice.dim)]
        box = (1,) * lead + lattice.shape
        nodes = np.ones(box, bool) if lattice.mask is None else lattice.mask.reshape(box)
        in_full = np.zeros((3, 2), bool)
        for (axis, side), boundary in self.sides.items():
            in_full[lead + axis, int(side > 0)] = boundary.held is not None
        of_bonds = self.grid.engine.bonds.energy(
            tuple(first), tuple(f + n for f, n in zip(first, box, strict=True)), nodes, in_full, cold
        )
        return float(self.near.mass * (of_bonds + self._of_faces()[0]))

    def friction(self) -> dict[str, float]:
        """Return the energy that friction between the faces of cracks has dissipated, by its name, after the strain
        energy; none without friction.
        """
        return {"friction": float(self.near.mass * self._of_faces()[1])} if self.law.friction else {}

    def _of_faces(self) -> tuple[float, float]:
        lattice, places = self.near.lattice, self.grid.nodes.reshape(self.near.lattice.shape)
        there = places if lattice.mask is None else places[lattice.mask]
        return energies_of_faces(self.grid.engine, there.ravel())

    def margin(self) -> IntactMargin | None:
        """Return the margin in which bonds cannot break, to be checked whenever a longitudinal wave has crossed one
        reach; None if there is none.
        """
        engine, lattice, law, near = self.grid.engine, self.near.lattice, self.law, self.near
        part, offsets = self.grid.near, engine.offsets[:, self.grid.lead :]
        low, high = (
            np.clip(
                np.array(edge[self.grid.lead :]) - [self.grid.margins[a, -1] for a in range(lattice.dim)],
                0,
                lattice.shape,
            )
            for edge in (self.zone.first, self.zone.end)
        )
        outside = np.ones(lattice.shape, bool)
        outside[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = False
        corners = np.argwhere(outside)
        bits = self._bits_inside(corners, engine.bonds.present(part).reshape(-1, *lattice.shape)[:, outside])
        held, limit = bits.any(0), engine.bonds.limit
        if not held.any() or not np.isfinite(limit):
            return None
        bonds = lattice.spacing * offsets.astype(float)
        if len(
            engine.get("bonds.released")
        ):  # bonds that break by energy share the elongation limit of the longest one
            lengths = np.linalg.norm(bonds, axis=1)
            bonds *= (lengths.max() / lengths)[:, None]
        crossing = min(near.stencil.reach) * lattice.spacing / np.sqrt(law.p_modulus / law.density * near.strongest)
        return IntactMargin(
            self.grid.nodes.reshape(lattice.shape)[outside][held],
            corners[held],
            np.ascontiguousarray(bits[:, held]),
            self.grid.layout.distances,
            np.ascontiguousarray(bonds, float),
            limit,
            law.nonlinear,
            engine.bonds.strengths,
            max(1, int(crossing / near.dt)),
            bool(self.regions),
        )

    def _bits_inside(self, corners: np.ndarray, bits: np.ndarray) -> np.ndarray:
        """Return the bits of the bonds of some nodes, shape (words, n), without those of bonds that leave the near
        field, and of bonds through the face of an incident wave's box, which have no meaningful stretch.
        """
        lattice = self.near.lattice
        boxes = [np.zeros(lattice.shape, bool) for _ in self.regions]
        for inside, region in zip(boxes, self.regions, strict=True):
            bounds = np.maximum([region.along(axis, lattice) for axis in range(lattice.dim)], 0)
            inside[tuple(slice(*pair) for pair in bounds)] = True
        for k, offset in enumerate(self.grid.engine.offsets[:, self.grid.lead :]):
            neighbours = corners + offset
            leaves = ((neighbours < 0) | (neighbours >= lattice.shape)).any(1)
            neighbours_inside = tuple(np.where(leaves[:, None], corners, neighbours).T)
            for inside in boxes:
                leaves |= inside[tuple(corners.T)] != inside[neighbours_inside]
            bits[k >> 6, leaves] &= ~(np.uint64(1) << np.uint64(k & 63))
        return bits

    def open_ends(self, cracks: Iterable[Cut]) -> list[Key]:
        """Return the sides within one reach of which there are cracks whose faces would meet, but do not."""
        near, open_sides = self.near, set()
        for (low, high), (key, side) in itertools.product((cut.bounds() for cut in cracks), self.sides.items()):
            if self.law.contact and side.bonded and not (side.periodic or side.shared or side.extended):
                axis, sign = key
                edge = (near.lattice.lower if sign < 0 else near.lattice.upper)[axis]
                beyond = sign * ((low if sign < 0 else high)[axis] - edge) / near.lattice.spacing
                if beyond > -near.stencil.reach[axis]:
                    open_sides.add(key)
        return sorted(open_sides)

    def check_start(self, force: np.ndarray) -> None:
        """Refuse initial data that would break bonds at once, and a load (`force`, of the field's shape) whose first
        strain would shatter whatever it meets; note one whose first strain would break bonds.
        """
        limit, near = self.critical_stretch, self.near
        if not np.isfinite(limit) or self.law.law is not None:
            return
        if self.law.caution is not None:
            self.cuts.notes.append(self.law.caution)
        strains = self.grid.engine.bonds.largest_strain(), self.grid.engine.bonds.limit
        stretch, least = (float(np.sqrt(1 + e) - 1 if self.law.nonlinear else e / 2) for e in strains)
        if stretch > least:
            raise InputError(
                f"the initial displacements{' and temperatures' * self.law.warm} stretch bonds beyond the critical "
                "stretch",
                value=f"{least:.6g}",
                limit=f"> {stretch:.4g}",
                key="model.critical_stretch",
                remedy="a smaller start, or cracks",
            )
        factor = np.broadcast_to(1.0 if near.factor is None else near.factor, near.field_shape)
        force = np.abs(force) / near.model.source_factor
        largest = float(np.divide(force, factor, out=np.zeros_like(force), where=factor > 0).max(initial=0))
        strain = largest * near.lattice.spacing / self.law.p_modulus
        if strain > _SHATTERS * limit:
            raise InputError(
                "the critical stretch is far below the first strain of the load, which would shatter what it meets",
                value=f"{limit:.6g}",
                limit=f">= {strain / _SHATTERS:.3g}",
                key="model.critical_stretch",
                remedy="a smaller load, or one that rises in time",
            )
        if strain > limit:
            self.cuts.notes.append(
                f"the load's first strain, about {strain:.3g}, is above the critical stretch {limit:.3g}: bonds break "
                "at once"
            )


def check_margin(run: Any, margin: IntactMargin | None, every: int) -> None:
    """Warn if bonds in the margin of a run are stretched beyond their limit, every `every` steps, if that is positive;
    on several processes any of them may have such bonds.
    """
    if not every or run.step_count < run.next_look:
        return
    run.next_look = (run.step_count // every + 1) * every
    level = run.engine.get("u").copy()
    warnings_of_all = run.team.gather(None if margin is None else margin.warning(level, run.lattice))
    warning = next((text for text in warnings_of_all if text is not None), None)
    if warning is not None:
        warn_once(run, "crack where bonds cannot break", warning)
