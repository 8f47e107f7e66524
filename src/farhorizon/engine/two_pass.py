"""Operators of two passes: sums over bonds yield the states of the nodes, and sums over the states yield the forces.

Each pass is a stencil of matrices from one field to another. It is swept, cut and continued into layers like the
stencil of an engine, which in turn is the pass of the springs. Since stretched shifts can be applied one after the
other, two passes with layers of their own absorb what their convolution absorbs, and do so also beside free faces and
along cracks, where no stencil is their convolution. Between them a law acts node by node.

A node that lacks bonds may have its own matrix in the law (its shape tensor is that of the bonds that are present), and
its own state counts: ``sum_k D_k (p_k + p_i)`` over the bonds that are present.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.bonds import factors_of
from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.codegen.choose import compiled_sums, equal_blocks
from farhorizon.engine.codegen.matrices import Signs, signs_of
from farhorizon.engine.derivative_pml import DerivativePML, stretches_of, without_bonds
from farhorizon.engine.field import Field
from farhorizon.engine.layer_operators import cut_layers
from farhorizon.engine.layer_tables import LayerTables
from farhorizon.engine.layout import aligned_zeros, with_defaults
from farhorizon.engine.missing_bonds import law_rows, surface_of
from farhorizon.engine.operations import layered_states, state_operations
from farhorizon.engine.point_law import CHUNK, PointLaw
from farhorizon.engine.shape_tensors import harmonic_eigenvalue
from farhorizon.engine.tables import Cuts, Pass, Sweep
from farhorizon.errors import InputError

_STRAIGHT = 1e-9  # off-diagonal entries of a shape tensor that are rounding


@dataclass(frozen=True)
class StateSums:
    """The two passes of an operator, on the K offsets of its springs, see `farhorizon.medium.force_states`."""

    gradient: np.ndarray  # shape (K, n, d)
    divergence: np.ndarray  # in units of the operator, shape (K, d, n)
    shapes: np.ndarray  # shape (K, e, e)
    law: Callable[[np.ndarray, np.ndarray], np.ndarray]
    moduli: np.ndarray  # shape (3,), or (3, ...) with the shape of the core
    signs: Signs
    kept: bool = False  # whether bonds that are cut or break leave the shape tensors of their nodes unchanged
    # For bonds that break by the energy lost with them: that energy, in units of the operator; shape (K, 3).
    released: np.ndarray | None = None
    # Whether nodes bear all of their stress down to the last of their bonds, see `engine.shape_tensors.stress_left`.
    unweakened: bool = False
    # Rates of the stretch of the derivatives along each axis, shape (d, *core), and its shift alpha, shape of the core;
    # see `engine.stretches`.
    phi: np.ndarray | None = None
    alpha: np.ndarray | None = None


class TwoPassOperator:
    """The two passes of an engine that already has its layout."""

    def __init__(self, engine: Field, sums: StateSums) -> None:
        self.engine: Field = weakref.proxy(engine)  # the engine refers to this: a cycle would keep its levels alive
        self.layout, self.offsets, self.dtype, self.sums = engine.layout, engine.offsets, engine.dtype, sums
        vector = signs_of(engine.components)
        self.weights = sums.gradient, sums.divergence
        self.signs = (vector, sums.signs), (sums.signs, vector)
        self.layer_tables = tuple(
            LayerTables(engine.layer_setup, weights, *signs)
            for weights, signs in zip(self.weights, self.signs, strict=True)
        )
        self.stretches = self._stretches()
        self.start = 0  # start of the memory of stretched derivatives in the engine's memory
        self.scales = [np.ones(len(engine.stages.numbers)), np.array([n[2] for n in engine.stages.numbers])]

    def _stretches(self) -> DerivativePML:
        """Return the stretches of nodes with all their bonds."""
        phi, alpha, dim = self.sums.phi, self.sums.alpha, self.engine.components
        if phi is None or alpha is None:
            return with_defaults(DerivativePML, self.dtype)
        return stretches_of(
            self.layout.box,
            phi,
            alpha,
            self.engine.dt,
            np.ascontiguousarray(self.sums.divergence[:, 0, :dim]).astype(self.dtype),
            self.layout.distances,
        )

    def stretch_tables(self) -> DerivativePML:
        """Return the stretches together with work space for the threads."""
        return self.stretches._replace(room=np.zeros((self.engine.threads, CHUNK), self.dtype))

    def tables(self, bond_stencil: Sweep) -> tuple[Pass, Pass]:
        """Return the tables of both passes with all bonds; the box is divided as for the sweep of the springs."""
        passes = []
        for number, (weights, signs) in enumerate(zip(self.weights, self.signs, strict=True)):
            rows, columns = weights.shape[1:]
            blocks = self.engine.components if equal_blocks(weights, self.engine.components) else 1
            function, row = self._compiled(weights, signs, blocks, ("sum", "add")[number])
            scale = self.scales[number][:, None]
            sweep = bond_stencil._replace(
                block=self.layout.table(columns // blocks, rows // blocks),
                function=function,
                blocks=blocks,
                weights=(scale * row).astype(self.dtype),
                offsets=self.layout.distances,
                general=(scale * weights.ravel()).astype(self.dtype),
                law=with_defaults(PointLaw, self.dtype) if number else self._law(),
            )
            layers = self.layer_tables[number].layers
            passes.append(with_defaults(Pass, self.dtype, sweep=sweep, layers=layers, columns=columns, rows=rows))
        return passes[0], passes[1]

    def _compiled(
        self, weights: np.ndarray, signs: tuple[Signs, Signs], blocks: int, form: str
    ) -> tuple[int, np.ndarray]:
        """Address of the compiled rows of one of a number of equal blocks of the weights, and their weights."""
        rows, columns = (count // blocks for count in weights.shape[1:])
        inside, outside = signs[0][:columns], signs[1][:rows]
        return compiled_sums(self.offsets, weights[:, :rows, :columns], inside, outside, form, self.dtype.name)

    def leave_out(
        self, nodes: np.ndarray, neighbours: np.ndarray, bare_nodes: np.ndarray, bare: np.ndarray, exists: np.ndarray
    ) -> None:
        """Set the bonds that are absent from now on: cut ones by place, one entry per direction in the order of the
        nodes, and for S nodes which of their bonds have only one end, (K, S); an InputError if the shape tensor of a
        node with stretched derivatives is not diagonal.
        """
        missing = _MissingBonds.of(self, nodes, neighbours, bare_nodes, bare, exists)
        shapes, left = self._shapes_beside(missing)
        gradient_pass, divergence_pass = self._cut_passes(missing)
        law = self._law_beside(gradient_pass.sweep.law, missing, shapes, left)
        self.engine.replace(
            gradient_pass=gradient_pass._replace(sweep=gradient_pass.sweep._replace(law=law)),
            divergence_pass=divergence_pass,
        )
        if len(self.engine.tables.bonds.released):
            self._spread_harmonic_eigenvalue(law)
        if self.engine.tables.stretches.runs.size:
            self._cut_stretches(missing, shapes)

    def _shapes_beside(self, missing: _MissingBonds) -> tuple[np.ndarray, np.ndarray]:
        """Shape tensors of nodes that lack bonds: those that the law uses, and those of the remaining bonds."""
        intact = np.eye(self.sums.shapes.shape[1])
        bare, cut = missing.sums(self.sums.shapes)
        return intact - bare - (0 if self.sums.kept else cut), intact - bare - cut

    def _cut_passes(self, missing: _MissingBonds) -> tuple[Pass, Pass]:
        """Return both passes without these bonds."""
        engine, exists, passes = self.engine.tables, missing.deficient_exist, []
        both = zip((engine.gradient_pass, engine.divergence_pass), self.weights, self.layer_tables, strict=True)
        for number, (before, weights, tables) in enumerate(both):
            bare, cut = missing.sums(weights)
            surface, of_cut = bare if number == 0 else -bare - 2 * cut, weights[missing.bonds]
            passes.append(
                before._replace(
                    cuts=Cuts(missing.nodes, missing.neighbours, of_cut.astype(self.dtype).ravel()),
                    layers=cut_layers(tables, missing.nodes, missing.neighbours, of_cut),
                    surface=surface_of(self.layout.box, missing.deficient[exists], surface[exists].astype(self.dtype)),
                )
            )
        return passes[0], passes[1]

    def _law_beside(self, law: PointLaw, missing: _MissingBonds, shapes: np.ndarray, left: np.ndarray) -> PointLaw:
        """Return the law with matrices of nodes that lack bonds, one for all nodes with the same tensors and moduli."""
        dim, deficient, exist = shapes.shape[1], missing.deficient, missing.deficient_exist
        tensors = [tensor[exist].round(14).reshape(-1, dim * dim) for tensor in (shapes, left)]  # equal up to rounding
        kinds, numbers = np.unique(np.hstack([*tensors, self.moduli_at(deficient[exist])]), axis=0, return_inverse=True)
        nothing = np.zeros((1, *self.sums.gradient.shape[1:2] * 2))
        of_law, present = kinds[:, :-3].reshape(-1, 2, dim, dim).swapaxes(0, 1)
        matrices = np.concatenate([nothing, self.sums.law(of_law, kinds[:, -3:])]).astype(self.dtype)
        of_node = np.zeros(len(deficient), np.int64)
        of_node[exist] = 1 + numbers.ravel()
        rows = law_rows(self.layout.box, deficient, of_node, matrices)
        first, end = (np.zeros(3, np.int64), np.zeros(3, np.int64)) if len(missing.nodes) else self._complete_box()
        return law._replace(
            nodes=deficient.astype(np.int64),
            numbers=of_node,
            matrices=rows.weights[: matrices.size].reshape(matrices.shape),
            rows=rows,
            harmonic_eigenvalue=(not self.sums.unweakened)
            * np.append(1.0, harmonic_eigenvalue(of_law)).astype(self.dtype),
            first=first,
            end=end,
            units=np.vstack([nothing[0, :1], self._units(present)]).astype(self.dtype),
        )

    def _spread_harmonic_eigenvalue(self, law: PointLaw) -> None:
        """Set the firmness of the ends of bonds that break by their energy."""
        firm = np.ones(self.layout.size)
        firm[law.nodes] = law.harmonic_eigenvalue[law.numbers]
        firm = self.engine.spread(firm[self.layout.near.node_indices()], jointly=True)
        self.engine.replace(bonds=self.engine.tables.bonds._replace(harmonic_eigenvalue=firm))

    def _cut_stretches(self, missing: _MissingBonds, shapes: np.ndarray) -> None:
        """Remove the missing bonds from the stretched derivatives."""
        stretches, deficient, dim = self.engine.tables.stretches, missing.deficient, shapes.shape[1]
        vectors = np.zeros((len(deficient) + 1, dim))
        vectors[:-1] = sum(missing.sums(self.sums.divergence[:, 0, :dim]))
        lacking = np.isin(stretches.places, deficient)
        at = np.where(lacking, np.searchsorted(deficient, stretches.places), len(deficient))
        _check_straight(shapes[at[lacking & missing.exists[stretches.places]]])
        cut = missing.nodes, missing.neighbours, missing.bonds
        self.engine.replace(stretches=without_bonds(stretches, vectors[at].T, *cut))

    def _units(self, shapes: np.ndarray) -> np.ndarray:
        """State of a unit strain in all directions, for nodes with given shape tensors; shape (S, n)."""
        count, dim = len(self.sums.signs), shapes.shape[1]
        return shapes.reshape(-1, dim * dim) if count > 1 else np.trace(shapes, axis1=1, axis2=2)[:, None]

    def _complete_box(self) -> tuple[np.ndarray, np.ndarray]:
        """First node, and last + 1, of the box of nodes to whose states no layer adds."""
        if self.sums.phi is not None:
            return self._unstretched()
        return self.layout.away

    def _unstretched(self) -> tuple[np.ndarray, np.ndarray]:
        """Return `_complete_box` for stretched derivatives, which exclude other layers."""
        first, end = np.zeros(3, np.int64), np.array(self.layout.box.nodes)
        free = ~np.any(np.asarray(self.sums.phi) > 0, axis=0)
        for axis in range(3):
            inside = np.flatnonzero(np.any(free, axis=tuple(a for a in range(3) if a != axis)))
            first[axis], end[axis] = (inside[0], inside[-1] + 1) if inside.size else (0, 0)
        return first, end

    def _law(self) -> PointLaw:
        """Return the law of nodes with all their bonds."""
        none, count = np.zeros(0, np.int64), len(self.sums.signs)
        identity, moduli = np.eye(self.sums.shapes.shape[1])[None], self.sums.moduli
        bases = np.concatenate([self.sums.law(identity, unit[None]) for unit in np.eye(3)])
        varies = moduli.ndim > 1
        local = np.stack([self.engine.spread(modulus) for modulus in moduli]) if varies else np.zeros((3, 0))
        middle, real = moduli.reshape(3, -1)[:, 0], self.dtype.name
        intact = np.einsum("c,cab->ab", middle, bases).astype(self.dtype)
        some = tuple(tuple(np.flatnonzero(row).tolist()) for row in np.any(bases, axis=0))
        dense, nothing = (tuple(range(count)),) * count, np.zeros((1, count, count), self.dtype)
        functions = [  # indexed by `WHOLE`, `ALIKE`, `EACH`
            load_rows("map_rows", entries=entries, columns=count, each=each, added=False, real=real)[0]
            for entries, each in ((some, False), (dense, False), (dense, True))
        ]
        first, end = self._complete_box()
        return with_defaults(
            PointLaw,
            self.dtype,
            values=aligned_zeros(count * self.layout.size, self.dtype),
            functions=np.array(functions),
            intact=np.ascontiguousarray(intact),
            matrices=nothing,
            rows=law_rows(self.layout.box, none, none, nothing),
            harmonic_eigenvalue=np.full(1, not self.sums.unweakened, self.dtype),
            moduli=middle.astype(self.dtype),
            local=local.astype(self.dtype),
            bases=bases.astype(self.dtype),
            shapes=self.sums.shapes.reshape(len(self.sums.shapes), -1).astype(self.dtype),
            kept=self.sums.kept or self.sums.released is not None,
            first=first,
            end=end,
            room=np.zeros((self.engine.threads, count, CHUNK), self.dtype),
            unit=self._units(identity)[0].astype(self.dtype),
            units=np.zeros((1, count), self.dtype),
        )

    def energy_of_heat(self) -> np.ndarray:
        """Energy of each place, per unit mass of a node, if nodes with thermal strains are held at zero displacement;
        the current states must be those of such nodes.
        """
        engine, law, bonds = self.engine, self.engine.tables.gradient_pass.sweep.law, self.engine.tables.bonds
        energy, dim = np.zeros(self.layout.size), self.sums.shapes.shape[1]
        nodes = self.layout.box.node_indices().ravel()
        thermal_strain, shapes = law.thermal_strain.astype(float), np.zeros((len(nodes), dim, dim))
        for k, distance in enumerate(bonds.places[:, 0]):
            alive = bonds.alive[k >> 6, nodes] >> np.uint64(k & 63) & np.uint64(1) != 0
            shapes += alive[:, None, None] * self.sums.shapes[k]
            factors = factors_of(engine.tables.material, nodes, nodes + distance)
            spring = law.arms[k] @ engine.weights[k] @ law.arms[k]
            energy[nodes] += (
                alive * factors * spring * (thermal_strain[nodes] + thermal_strain[nodes + distance]) ** 2 / 16
            )
        states = law.values.reshape(len(self.sums.signs), -1)[:, nodes]
        strained = float(law.spacing) * thermal_strain[nodes, None] * self._units(shapes)
        energy[nodes] -= self._unit * (states.T * strained).sum(1) / 2
        return energy

    @property
    def _unit(self) -> float:
        """Unit of the operator: ratio of the divergence to the transposed gradient."""
        gradient, divergence = self.sums.gradient[:, 0, 0], self.sums.divergence[:, 0, 0]
        return float(divergence @ gradient / (gradient @ gradient))

    def states_of(
        self, level: np.ndarray, thermal: bool = False, halo: bool = False, layered: bool = False
    ) -> np.ndarray:
        """Results of the law for the states of a level, as a level with that many components, which the next step
        overwrites; the halo of `level` is filled, and that of the states if `halo` is set.

        If `layered`, the halo of `level` must be filled already, and the layers, whose memory stays unchanged, add to
        the states.
        """
        tables = self.engine.tables
        operations = layered_states(tables) if layered else state_operations(tables, halo)
        self.engine.operate(level, operations, keep_memory=layered, thermal=thermal, again=True)
        return tables.gradient_pass.sweep.law.values

    def units_of_bonds(self) -> np.ndarray:
        """Contribution of each bond to the state of a unit strain in all directions, shape (K, n), times the factor of
        a state in the energy.
        """
        return self._unit * float(self.engine.tables.gradient_pass.sweep.law.spacing) * self._units(self.sums.shapes)

    def moduli_at(self, nodes: np.ndarray) -> np.ndarray:
        """Moduli of some nodes in the law, shape (S, 3)."""
        law = self.engine.tables.gradient_pass.sweep.law
        return law.local[:, nodes].T if law.local.size else np.tile(law.moduli, (len(nodes), 1))


@dataclass(frozen=True, eq=False)
class _MissingBonds:
    """Bonds that are absent, and the nodes that lack them."""

    nodes: np.ndarray  # ends of bonds that are cut, one entry per direction, and their numbers in the stencil; (n,)
    neighbours: np.ndarray
    bonds: np.ndarray
    deficient: np.ndarray  # nodes that lack bonds, ascending
    at: np.ndarray  # indices in `deficient` of the first ends of cut bonds, shape (n,)
    beside: np.ndarray  # indices in `deficient` of the S nodes with bonds of which only one end exists
    bare: np.ndarray  # for each of the latter, which bonds these are; shape (K, S)
    exists: np.ndarray  # by place

    @classmethod
    def of(
        cls,
        passes: TwoPassOperator,
        nodes: np.ndarray,
        neighbours: np.ndarray,
        bare_nodes: np.ndarray,
        bare: np.ndarray,
        exists: np.ndarray,
    ) -> _MissingBonds:
        """Construct from the arguments of `TwoPassOperator.leave_out`."""
        bonds = passes.layout.bonds_between(nodes, neighbours)
        deficient = np.union1d(nodes, bare_nodes)
        at, beside = np.searchsorted(deficient, nodes), np.searchsorted(deficient, bare_nodes)
        return cls(nodes, neighbours, bonds, deficient, at, beside, bare, exists)

    @property
    def deficient_exist(self) -> np.ndarray:
        """Which of the nodes `deficient` exist."""
        return np.asarray(self.exists[self.deficient])

    def sums(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums of the weights, over the bonds of each node whose other end does not exist, and over those that are
        cut.
        """
        bare, cut = (np.zeros((len(self.deficient), *weights.shape[1:])) for _ in range(2))
        bare[self.beside] = np.einsum("ks,k...->s...", self.bare, weights)
        np.add.at(cut, self.at, weights[self.bonds])
        return bare, cut


def _check_straight(shapes: np.ndarray) -> None:
    """Raise an error unless the shape tensors of nodes with stretched derivatives are diagonal."""
    if np.abs(shapes * (1 - np.eye(shapes.shape[1]))).max(initial=0) > _STRAIGHT:
        raise InputError(
            "missing bonds in a layer must be those of a plane along its normal",
            key="boundary",
            remedy="keep cracks, corners and holes in the near field, one reach away from the layers",
        )
