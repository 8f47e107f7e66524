"""Absent bonds: cut by cracks, crossing a free side, leading to nodes outside a body, or beyond a thin halo."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from farhorizon.boundaries import OutlineCondition
from farhorizon.engine.features.faces import set_faces
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.cracks import Crack, cut_bonds
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, side_name
from farhorizon.simulation.sides.layered_sides import LayeredSides

# nodes, the neighbours at the other ends of their bonds, and the weights that these bonds lose
Bonds = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class CutBonds:
    """Absent bonds of a near field on its grid."""

    near: NearField
    layered: LayeredSides
    grid: Grid
    closure: OutlineCondition | None
    free_rim: bool  # whether bonds to nodes outside a body are absent
    notes: list[str]  # receives notes for the user
    _known: dict[int, tuple[Crack, list[Bonds]]] = field(default_factory=dict, init=False)

    def cut(self, cracks: Sequence[Crack], more: Bonds | None = None) -> None:
        """Remove the bonds across some cracks, those that are absent in any case, and perhaps others; raises InputError
        for a crack that crosses a side that cannot continue it, or cuts bonds that a condition along the outline reads.
        """
        engine = self.grid.engine
        absent = [bonds for crack in cracks for bonds in self._lost(crack)]
        if self.closure is not None:
            absent += self._beyond_halo(self.closure)
        absent.append((np.zeros(0, np.int64), np.zeros(0, np.int64), engine.weights[:0]) if more is None else more)
        nodes, neighbours, weights = (np.concatenate([f[i] for f in absent]) for i in range(3))
        size = np.abs(weights).max(axis=tuple(range(1, weights.ndim)))
        order = np.argsort(-size, kind="stable")  # where two cracks cross a bond, the one that removes more counts
        nodes, neighbours, weights = nodes[order], neighbours[order], weights[order]
        _, first = np.unique(nodes * self.grid.layout.size + neighbours, return_index=True)
        bare = self.free_rim or not all(b.bonded for b in self.layered.sides.values())
        engine.absent.set(
            nodes[first], neighbours[first], weights[first], self.existing(self.free_rim) if bare else None
        )
        law = self.near.model.bond_law
        if law is not None and law.slides and engine.bonds and cracks:
            set_faces(engine, *self._faces(cracks), law.friction, law.shear / law.p_modulus)

    def _faces(self, cracks: Sequence[Crack]) -> Bonds:
        """Return the bonds of the core that cracks cut altogether: nodes, neighbours, and the normals of the cracks."""
        engine, faces = self.grid.engine, [(np.zeros(0, np.int64),) * 2 + (np.zeros((0, self.near.lattice.dim)),)]
        for crack in cracks:
            if crack.factor:
                continue
            nodes, neighbours, _ = self._lost(crack)[0]
            start, end = (
                self.grid.origin + self.near.lattice.spacing * engine.core.coordinates(places)[:, self.grid.lead :]
                for places in (nodes, neighbours)
            )
            faces.append((nodes, neighbours, crack.cut.normals(start, end)))
        nodes, neighbours, normals = (np.concatenate(parts) for parts in zip(*faces, strict=True))
        return nodes, neighbours, normals

    def _lost(self, crack: Crack) -> list[Bonds]:
        """Return the bonds across a crack, those in the core and those in the layers as separate entries; results are
        kept, because cracks may open one after the other.
        """
        if id(crack) in self._known:
            return self._known[id(crack)][1]
        engine, block, lead = self.grid.engine, self.grid.core, self.grid.lead
        cut, lost = crack.cut, 1 - crack.factor
        crossed = self._crossed(cut)
        nodes, bonds = cut_bonds(
            cut, self.grid.origin, self.near.lattice.spacing, block.nodes[lead:], engine.offsets[:, lead:]
        )
        flat = block.origin + nodes @ np.array(block.stride[lead:])
        lost_bonds = [(flat, flat + engine.offsets[bonds] @ np.array(block.stride), lost * engine.weights[bonds])]
        if self.closure is not None and np.isin(flat, self.closure.nodes).any():
            raise InputError(
                "a crack cuts bonds of nodes that a condition along the outline reads",
                key="crack",
                value=[b.tolist() for b in cut.bounds()],
                remedy="enlarge the near field, or use a LatticePML",
            )
        corners = [pair for pair in itertools.combinations(crossed, 2) if pair[0][0] != pair[1][0]]
        for keys in (*((key,) for key in crossed), *corners):
            *ends, weights = self._continued(cut, nodes, bonds, keys)
            lost_bonds.append((ends[0], ends[1], lost * weights))
        self._known[id(crack)] = crack, lost_bonds  # keeps the crack alive, so that its id stays unique
        return lost_bonds

    def existing(self, body: bool) -> np.ndarray:
        """Return, for each place of a level, whether the medium has a node: not beyond free sides and, if `body`, not
        outside the body.
        """
        lattice, engine = self.near.lattice, self.grid.engine
        core = np.ones(self.grid.core.nodes)
        if body and lattice.existing is not None:
            core = self.grid.grown(lattice.existing.astype(float))
        beyond = {key: 0.0 for key, b in self.layered.sides.items() if not b.bonded}
        return engine.spread(core, self.grid.keyed(beyond), jointly=body and lattice.body is not None) > 0.5

    def _beyond_halo(self, closure: OutlineCondition) -> list[Bonds]:
        """Return the bonds that lead from the near field beyond a halo thinner than the reach of the stencil."""
        engine, block = self.grid.engine, self.grid.core
        at_rest = self.grid.keyed(dict.fromkeys(closure.outline.sides, 0.0))
        exists = engine.spread(np.reshape(~closure.outside, block.nodes), at_rest) > 0.5
        near = block.node_indices().reshape(closure.halo.shape)[closure.outline.near]
        rows = []
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            neighbours = near + int(offset @ np.array(block.stride))
            lost = ~exists[neighbours]
            rows.append((near[lost], neighbours[lost], np.repeat(np.asarray(weight)[None], int(lost.sum()), axis=0)))
        return rows

    def _crossed(self, cut: Cut) -> list[Key]:
        """Return the sides with a layer that a crack enters; raises InputError if it crosses a side that cannot
        continue it, such as a sponge. Beyond other sides it is cut as given.
        """
        lattice, crossed = self.near.lattice, []
        for (axis, side), boundary in self.layered.sides.items():
            edge = (lattice.lower, lattice.upper)[(side + 1) // 2][axis]
            end = cut.bounds()[(side + 1) // 2][axis]
            beyond = side * (end - edge) > 1e-9 * lattice.spacing  # more than rounding
            if beyond and boundary.cracks not in ("end", "repeat"):
                if boundary.cracks == "refuse":
                    raise InputError(
                        "a crack crosses a side that cannot continue it",
                        value=side_name(axis, side),
                        key="crack",
                        remedy="shorten it, or use a LatticePML there",
                    )
                crossed.append((axis, side))
        return crossed

    def _continued(self, cut: Cut, nodes: np.ndarray, bonds: np.ndarray, keys: Sequence[Key]) -> Bonds:
        """Return the bonds inside a layer that a crack parallel to its normal cuts, continued from those at the last
        nodes of the core; for two layers, those in their common corner.
        """
        engine, block, lead = self.grid.engine, self.grid.core, self.grid.lead
        strides = block.stride[lead:]
        places = np.zeros(1, np.int64)
        rest, last = nodes.copy(), np.ones(len(nodes), bool)
        for axis, side in keys:
            count, columns = block.nodes[lead + axis], self.layered.layers[axis, side].columns
            beyond = (count if side > 0 else -columns) + np.arange(columns)
            places = np.add.outer(places, beyond * strides[axis]).ravel()
            rest[:, axis] = 0
            last &= nodes[:, axis] == (count - 1 if side > 0 else 0)
        rows = np.column_stack([rest, bonds])
        continued = {tuple(row) for row in rows[last].tolist()}
        if len(keys) == 1:  # in a corner this was checked for both layers
            self._check_straight(cut, nodes, rows, continued, keys[0])
        table = np.array(sorted(continued), int).reshape(-1, self.near.lattice.dim + 1)
        flat = block.origin + table[:, :-1] @ np.array(strides) + places[:, None]
        neighbours = flat + engine.offsets[table[:, -1]] @ np.array(block.stride)
        return flat.ravel(), neighbours.ravel(), np.concatenate([engine.weights[table[:, -1]]] * len(places))

    def _check_straight(
        self, cut: Cut, nodes: np.ndarray, rows: np.ndarray, continued: set[tuple[int, ...]], key: Key
    ) -> None:
        """Check that a crack cuts the last columns of the core alike, and that in the layer, where it may end, it cuts
        only bonds that its straight continuation cuts, too.
        """
        axis, side = key
        count = self.grid.core.nodes[self.grid.lead + axis]
        for column in range(self.near.stencil.reach[axis] + 1):
            in_column = nodes[:, axis] == (count - 1 - column if side > 0 else column)
            if {tuple(row) for row in rows[in_column].tolist()} != continued:
                raise self._oblique(cut, key)
        spacing, columns = self.near.lattice.spacing, self.layered.layers[key].columns
        shape = list(self.grid.core.nodes[self.grid.lead :])
        origin = self.grid.origin.copy()
        origin[axis] += spacing * (shape[axis] if side > 0 else -columns)
        shape[axis] = columns
        offsets = self.grid.engine.offsets[:, self.grid.lead :]
        nodes, bonds = cut_bonds(cut, origin, spacing, tuple(shape), offsets)
        nodes[:, axis] = 0
        if not {(*r, b) for r, b in zip(nodes.tolist(), bonds.tolist(), strict=True)} <= continued:
            raise self._oblique(cut, key)
        note = f"the crack that runs into the layer at {side_name(*key)} is assumed to continue straight without end"
        if continued and note not in self.notes:
            self.notes.append(note)

    def _oblique(self, cut: Cut, key: Key) -> InputError:
        lattice = self.near.lattice
        return InputError(
            f"a crack may run across the absorbing side {side_name(*key)} only straight along its normal, "
            "and beyond its first nodes",
            key="crack",
            value=[b.tolist() for b in cut.bounds()],
            limit=f"{lattice.lower.tolist()} to {lattice.upper.tolist()}",
            remedy="end it inside, turn it, or enlarge the near field",
        )
