"""Bonds of a field that have a law of their own stretch and may break: their tables, and quantities computed from them.

See `farhorizon.engine.bonds` for the kernels.
"""

from __future__ import annotations

import weakref

import numpy as np

from farhorizon.engine import bonds as laws
from farhorizon.engine.bonds import (
    CHANGED,
    CLOSES,
    DAMAGED,
    END,
    FIRST,
    PLAIN,
    RULES,
    UNCHANGED,
    Bonds,
    StateBonds,
    Zone,
    all_bits,
    factors_of,
)
from farhorizon.engine.codegen.bond_functions import BondFunctions, function_sweep, stored
from farhorizon.engine.codegen.bond_sweeps import LANES, ROWS, BondLaw
from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.features.faces import Faces
from farhorizon.engine.features.thermal_strain import add_traces, add_traces_of_states
from farhorizon.engine.field import Field
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.operations import trace_operations
from farhorizon.engine.release import LINES, PATCH_NODES, largest_energy

_SET_BITS = np.array([number.bit_count() for number in range(256)], np.uint8)


class BondZone:
    """Zone of an engine where bonds have a law of their own stretch; empty until it is `set`."""

    def __init__(self, engine: Field) -> None:
        self.engine: Field = weakref.proxy(engine)  # the engine refers to this: a cycle would keep its levels alive
        self.softening: str | None = None  # how bonds soften beyond their limit
        self.functions: BondFunctions | None = None  # of a law that is a function
        self._unbroken: np.ndarray | None = None

    def expect_cuts(self) -> None:
        """Keep the bits of all bonds that are not cut, to tell those that break from those that are cut later."""
        if self._unbroken is None:
            self._unbroken = self.table.alive.copy()

    @property
    def broken_bits(self) -> np.ndarray:
        """Bits of the bonds of the nodes of the core that have broken since `expect_cuts` and are not cut, shape
        (words, *core).
        """
        assert self._unbroken is not None
        nodes = self.engine.core.node_indices()
        return self._unbroken[:, nodes] & ~self.table.alive[:, nodes]

    @property
    def table(self) -> Bonds:
        """Tables of the bonds for the compiled loop."""
        return self.engine.tables.bonds

    def set(
        self,
        stiffness: np.ndarray,
        spacing: float,
        zone: Zone,
        nonlinear: bool,
        limit: float,
        strength: np.ndarray | None = None,
        contact: bool = False,
        warm: bool = False,
        softening: str | None = None,
        final: np.ndarray | None = None,
        contact_stiffness: np.ndarray | None = None,
        stiffness_of_nodes: np.ndarray | None = None,
        functions: BondFunctions | None = None,
        numbers: np.ndarray | None = None,
    ) -> None:
        """Set the zone, in nodes of the core: bonds with both ends in it have a law of their own stretch and may break.

        `stiffness`, shape (K,), is the force per unit elongation of each offset on a unit of mass, without
        coefficients; in state-based media that of closing bonds. Bonds with an ``|xi + eta|^2 / |xi|^2 - 1``
        (linearised: ``2 xi . eta / |xi|^2``) of up to `limit`, which may be infinite, do not break. With `contact`
        bonds that are cut or broken carry compression. Those beyond the limit may soften (`bond_sweeps.SOFTENINGS`)
        instead of breaking at once. `warm` nodes have thermal strains, see `engine.features.thermal_strain`.

        Three arrays have the shape of the core: `strength`, the limit of the bonds of each node relative to that of the
        weakest node, which is then `limit`, and the weaker end of a bond counts; `final`, the stretch at which
        softening bonds have lost all stiffness, not below the limit; and, in state-based media, `contact_stiffness`
        relative to the stiffness of the medium.

        The law may be `functions`, with `numbers` as in `Bonds.parameters`; bonds up to `limit` are then springs that
        remember nothing, unless they have been stretched more, and there are none where it is minus infinity.

        With `stiffness_of_nodes`, shape of the core, strengths are energies (`Bonds.stiffness`); `limit` must not
        exceed that of any bond.
        """
        engine, self.softening, self.functions, self._unbroken = self.engine, softening, functions, None
        block, components, forces = engine.layout.box, engine.components, engine.passes is None
        xi = spacing * engine.offsets[:, 3 - components :].astype(float)
        scaled = engine.stages.numbers[0][2] * np.asarray(stiffness)
        full = all_bits(len(engine.offsets))
        alive = np.zeros((len(full), block.origin + block.nodes[0] * block.stride[0] + LANES), np.uint64)
        alive[:, block.node_indices()] = full[:, None, None, None]
        zone = zone.moved(engine.layout.low)
        rows = block.nodes[0], -(-block.nodes[1] // ROWS[components])
        kinds = np.zeros((*rows, -(-(zone.end[2] - zone.first[2]) // LANES)), np.uint8)
        law = BondLaw(
            components,
            nonlinear,
            real=engine.dtype.name,
            rule=RULES[engine.tables.material.rule] if engine.tables.material.coefficient.size > 1 else None,
            strengths=strength is not None,
            energies=None if stiffness_of_nodes is None else RULES[engine.tables.material.rule],
            contact=contact and forces,
            thermal=warm,
            softening=softening,
            surface=len(engine.absent.excess) if forces else 0,
        )
        addresses = np.array(_sweeps(law, functions), np.int64)
        start = np.repeat(() if functions is None else functions.start, len(engine.offsets))
        released, bounds = self._energies(spacing)
        spread = {
            name: engine.spread(values, jointly=True)
            for name, values in (
                ("strength", strength),
                ("stiffness", stiffness_of_nodes),
                ("final", final),
                ("contact_stiffness", contact_stiffness),
            )
            if values is not None
        }
        bonds = with_defaults(
            Bonds,
            engine.dtype,
            functions=addresses,
            table=np.column_stack([xi, 1 / (xi**2).sum(1), scaled]).astype(engine.dtype),
            places=np.column_stack([engine.offsets @ np.array(block.stride), engine.offsets]).astype(np.int64),
            alive=alive,
            kinds=kinds,
            zone=zone.table(engine.layout.reach),
            limit=np.array([limit, (max(limit, 0.0) / 2 * spacing) ** 2], engine.dtype),
            nonlinear=nonlinear,
            rule=int(engine.tables.material.rule),
            broken=np.zeros((*rows, 2)),
            forces=forces,
            changed=np.zeros_like(kinds),
            full=full,
            thermal_strain=np.zeros(engine.layout.size if warm else 1, engine.dtype),
            residual_stiffness=np.ones(
                (len(engine.offsets) if softening or functions is not None else 0, alive.shape[1]), engine.dtype
            ),
            history=np.repeat(start.astype(engine.dtype)[:, None], alive.shape[1], 1),
            parameters=np.zeros(0) if numbers is None else numbers,
            released=released,
            bounds=bounds,
            room=np.zeros((engine.threads, LINES, PATCH_NODES + 2 * engine.layout.reach[2])),
            excess=engine.absent.excess.astype(engine.dtype),
            cosines=(engine.absent.cosines / 2).astype(engine.dtype),
            **spread,
        )
        if not forces:
            bonds = bonds._replace(before=alive.copy())
        if contact:
            bonds = bonds._replace(closing=alive.copy())
        engine.replace(bonds=bonds, faces=with_defaults(Faces, engine.dtype))
        engine.sweep_in_pieces(laws.PIECE_ROWS)
        self.find_kinds()

    def _energies(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Return `Bonds.released` and `Bonds.bounds`."""
        engine, passes = self.engine, self.engine.passes
        if passes is None or passes.sums.released is None:
            return np.zeros((0, 3)), np.zeros(2)
        unit, law, dim = engine.stages.numbers[0][2], engine.tables.gradient_pass.sweep.law, engine.components
        released = unit * spacing**2 * passes.sums.released
        least = most = law.moduli.astype(float)
        if law.local.size:
            for values in law.local:
                engine.join(values, {})
            of_nodes = np.stack([engine.layout.box.all(values) for values in law.local]).reshape(3, -1).astype(float)
            least, most = of_nodes.min(1), of_nodes.max(1)
        gradient, divergence = passes.sums.gradient[:, :dim, 0], unit * passes.sums.divergence[:, 0, :dim]
        lengths, slopes = (np.linalg.norm(vectors, axis=1) for vectors in (engine.offsets, divergence))
        springs = unit * float(engine.tables.material.coefficient.max()) / 2 * np.abs(engine.weights).sum((1, 2))
        pulls = most[2] * slopes * np.linalg.norm(gradient, axis=1)
        limits = 2 * released @ np.array([*least[:2], most[2]])
        limits = np.where(limits > 0, limits, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):  # bonds without weight never break
            bounds = 2 * slopes * lengths / limits, (springs + pulls) * lengths**2 / limits
        return released, np.array([np.nan_to_num(bound, posinf=np.inf).max() for bound in bounds])

    @property
    def nonlinear(self) -> bool:
        """Whether the law of the bonds is nonlinear."""
        return self.table.nonlinear

    def __bool__(self) -> bool:
        """Whether there is a zone."""
        return len(self.table.places) > 0

    @property
    def forces(self) -> bool:
        """Whether there is a zone whose bonds exert forces by their law."""
        return bool(self) and self.table.forces

    def clear(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Clear the bits of bonds of the core; return which of them have their node in the zone, where bits alone
        decide whether a bond is present.
        """
        block, places = self.engine.layout.box, self.table.places
        number = np.full(self.table.alive.shape[1], -1)
        number[block.node_indices().ravel()] = np.arange(int(np.prod(block.nodes)))
        inside = np.flatnonzero((nodes < len(number)) & (neighbours < self.engine.layout.size))
        inside = inside[number[nodes[inside]] >= 0]
        order = np.argsort(places[:, 0])
        bond = order[np.searchsorted(places[order, 0], neighbours[inside] - nodes[inside])]
        for bits in (self.table.alive, self._unbroken):
            if bits is not None:
                np.bitwise_and.at(bits, (bond >> 6, nodes[inside]), ~(np.uint64(1) << (bond & 63).astype(np.uint64)))
        if self._unbroken is not None and not self.table.forces:
            self._find_changed(self._unbroken)
        self.find_kinds()
        self._look_at_closing()
        self._remember()
        swept = np.zeros(len(nodes), bool)
        swept[inside] = self.contains(np.stack(np.unravel_index(number[nodes[inside]], block.nodes), axis=1))
        return swept

    def clear_bits(self, nodes: np.ndarray, gone: np.ndarray) -> None:
        """Clear the bits of the bonds `gone`, shape (K, nodes), of nodes of the core whose other ends do not exist."""
        for bits in (self.table.alive, self.table.closing):
            for bond, lacks_it in enumerate(gone if bits.size else ()):
                bits[bond >> 6, nodes[lacks_it]] &= ~(np.uint64(1) << np.uint64(bond & 63))
        self._remember()

    def part(self, nodes: np.ndarray, bonds: np.ndarray) -> None:
        """Let bonds of some places carry no compression along themselves."""
        gone = ~(np.uint64(1) << (bonds & 63).astype(np.uint64))
        np.bitwise_and.at(self.table.closing, (bonds >> 6, nodes), gone)
        self._look_at_closing()

    def _remember(self) -> None:
        """Store the present bits as those for which the lost energy has been accounted."""
        if not self.table.forces:
            self.table.before[...] = self.table.alive

    def contains(self, at: np.ndarray) -> np.ndarray:
        """Which nodes of the core, shape (N, 3), are in the zone, where bits alone decide whether a bond is present."""
        zone = self.table.zone
        return np.asarray(((at >= zone[FIRST:END]) & (at < zone[END:])).all(1))

    def find_kinds(self) -> None:
        """Find the plain tiles of the zone: all bonds are present, and none leaves the box where bonds follow the
        law.
        """
        block, kinds, zone = self.engine.layout.box, self.table.kinds, self.table.zone
        full = all_bits(len(self.table.places))[:, None, None, None]
        damaged = (self.table.alive[:, block.node_indices()] != full).any(0)
        for residual_stiffness in self.table.residual_stiffness:
            damaged |= residual_stiffness[block.node_indices()] < 1
        if self.functions is not None and self.limit < 0:  # there is nothing that a bond does not remember
            damaged[...] = True
        if self.table.forces:
            damaged[tuple(block.coordinates(self.engine.absent.stiffened[0]).T)] = True
        for axis, m in enumerate(self.engine.layout.reach):
            i = np.arange(block.nodes[axis])
            damaged |= ((i - m < zone[axis]) | (i + m >= zone[axis] + zone[3 + axis])).reshape(
                [-1 if a == axis else 1 for a in range(3)]
            )
        first, end = zone[FIRST:END], zone[END:]
        damaged[:, : first[1]] = damaged[:, end[1] :] = False  # rows of tiles that are not in the zone
        kinds[...] = np.where(self._tiles_with(damaged), DAMAGED, PLAIN)

    def _tiles_with(self, nodes: np.ndarray) -> np.ndarray:
        """Which tiles contain at least one of some nodes, which are given on the box."""
        kinds, zone, high = self.table.kinds, self.table.zone, ROWS[self.engine.components]
        nodes = nodes[:, :, zone[FIRST + 2] : zone[END + 2]]
        missing = [
            (0, count * size - n) for n, count, size in zip(nodes.shape, kinds.shape, (1, high, LANES), strict=True)
        ]
        tiles = np.pad(nodes, missing).reshape(kinds.shape[0], kinds.shape[1], high, kinds.shape[2], LANES)
        return np.asarray(tiles.any((2, 4)))

    def break_since(self, alive: np.ndarray) -> None:
        """Continue with the bits that have been written into the tables: bonds have broken since they were `alive`, and
        their energy is accounted.
        """
        self.find_kinds()
        if not self.table.forces:
            self._find_changed(alive)
            self._look_at_closing()
            self._remember()

    def _find_changed(self, unbroken: np.ndarray) -> None:
        """Find the tiles where bonds have broken, by comparison with the bits of bonds that are not cut."""
        gone = (self.table.alive != unbroken)[:, self.engine.layout.box.node_indices()].any(0)
        self.table.changed[...] = np.where(self._tiles_with(gone), CHANGED, UNCHANGED)

    def _look_at_closing(self) -> None:
        """Mark the tiles of a state-based medium that have absent bonds which may close."""
        table = self.table
        if table.closing.size and not table.forces:
            places = self.engine.layout.box.node_indices()
            may = ((table.closing & ~table.alive)[:, places] != 0).any(0)
            for axis in range(3):
                at = np.arange(may.shape[axis])
                outside = (at < table.zone[FIRST + axis]) | (at >= table.zone[END + axis])
                may &= ~outside.reshape([-1 if a == axis else 1 for a in range(3)])
            table.changed[self._tiles_with(may) & (table.changed == UNCHANGED)] = CLOSES

    @property
    def left(self) -> np.ndarray:
        """Number of remaining bonds of each node of the core; softening bonds count by their remaining stiffness."""
        nodes = self.engine.core.node_indices()
        bits = np.ascontiguousarray(self.table.alive[:, nodes])
        if self.table.residual_stiffness.size:
            total = np.zeros(nodes.shape)
            for k, residual_stiffness in enumerate(self.table.residual_stiffness):
                total += (bits[k >> 6] >> np.uint64(k & 63) & np.uint64(1)) * residual_stiffness[nodes]
            return total
        return _SET_BITS[bits[..., None].view(np.uint8)].sum((0, -1), dtype=np.int64)

    @property
    def state(self) -> dict[str, np.ndarray]:
        """Arrays of a checkpoint: bits, residual stiffnesses, kinds of tiles, and what broken bonds and work have added
        up to; they share memory.
        """
        table = self.table
        bonds = {"bonds": table.alive, "kinds": table.kinds, "broken": table.broken} if self else {}
        if not table.forces:
            bonds |= {"changed": table.changed, "before": table.before}
        if table.residual_stiffness.size:
            bonds["shares"] = table.residual_stiffness
        if table.history.size:
            bonds["history"] = table.history
        return bonds

    @property
    def broken(self) -> tuple[float, float]:
        """Energy lost by breaking and softening of bonds, per unit mass of a node, and the number of broken bonds;
        bonds to nodes of another process count half.
        """
        energy, count = self.table.broken.sum((0, 1))
        return float(energy) / self.engine.stages.numbers[0][2], float(count)

    def count_cut(self, energy: float) -> None:
        """Add the energy, per unit mass of a node, of bonds that were cut."""
        self.table.broken[0, 0, 0] += energy * self.engine.stages.numbers[0][2]

    def traces(self, level: np.ndarray | str, apart: bool = False) -> np.ndarray:
        """Factor of the thermal strain of each place in the energy of a level, or of one by name, per unit mass of a
        node: the sum of the normal stresses over the density.

        Zero outside the zone, unless heat passes through the layers; then, if `apart`, their memory is left unchanged.
        The halo of the level is filled.
        """
        engine = self.engine
        traces, block, material = np.zeros(engine.layout.size), engine.tables.sweep.block, engine.tables.material
        level = engine.array(level) if isinstance(level, str) else level
        engine.complete(level)
        thermoelastic, table = bool(engine.heat_passes), self.table
        if thermoelastic:
            table = table._replace(zone=Zone((0, 0, 0), engine.layout.box.nodes).table(engine.layout.reach))
        if engine.passes is not None:
            vectors, states = engine.tables.heat.vectors, engine.passes.states_of(level, layered=thermoelastic)
            add_traces_of_states(traces, states, block, table, engine.passes.units_of_bonds())
        else:
            xi, scaled = table.table[:, : engine.components], table.table[:, engine.components + 1 :]
            vectors = xi.astype(float) * scaled / engine.stages.numbers[0][2]
        if thermoelastic:
            vectors = engine.heat_vectors
            engine.tables.heat.traces[:] = 0
            engine.operate(level, trace_operations(engine.tables), apart, again=True)
            traces += engine.tables.heat.traces
        add_traces(traces, level, engine.components, block, material, table, vectors)
        return traces

    def energy(
        self, first: tuple[int, ...], end: tuple[int, ...], nodes: np.ndarray, full: np.ndarray, cold: bool = False
    ) -> float:
        """Energy of the bonds of some nodes from the present elongations and those of the previous step, per unit mass
        of a node; in state-based media that of closing bonds.

        `nodes` selects nodes of the box from `first` to `end` of the core; bonds to nodes beyond the box count half, or
        fully across sides that are `full`, shape (3, 2). If `cold`, thermal strains are not subtracted from the
        elongations.
        """
        self.engine.complete(self.engine.current)
        low = np.array(self.engine.layout.low)
        bounds = np.array(first, np.int64) + low, np.array(end, np.int64) + low
        table, material = self.table, self.engine.tables.material
        if not table.forces:
            none = table.excess[:0]
            table = table._replace(alive=0 * table.alive, closing=table.closing & ~table.alive, excess=none)
            material = material._replace(coefficient=table.contact_stiffness)
        by_function = 0.0
        if self.functions is not None:  # of the other bonds below
            by_function = self._stored(self.functions, *bounds, nodes, full)
            table = table._replace(residual_stiffness=0 * table.residual_stiffness)
        total = laws.strain_energy(
            self.engine.current,
            self.engine.older,
            self.engine.tables.sweep.block,
            *bounds,
            nodes,
            full,
            self.engine.components,
            material,
            table._replace(thermal_strain=table.thermal_strain[:1] * 0) if cold else table,
            bool(self.engine.heat_passes),
        )
        return (float(total) + by_function) / self.engine.stages.numbers[0][2]

    def _stored(
        self, functions: BondFunctions, first: np.ndarray, end: np.ndarray, nodes: np.ndarray, full: np.ndarray
    ) -> float:
        """Energy of the bonds of some nodes whose law is a function, in units of the update; arguments as in
        `energy`, in nodes of the box.
        """
        engine, table, block = self.engine, self.table, self.engine.layout.box
        places = block.node_indices()[tuple(slice(a, b) for a, b in zip(first, end, strict=True))][nodes]
        at = np.argwhere(nodes) + first
        levels = [level.reshape(engine.components, -1).astype(float) for level in (engine.current, engine.older)]
        xi, of_function, total = table.table[:, : engine.components].astype(float), stored(functions), 0.0
        curved = self._follows(at)
        for bond, (distance, *offset) in enumerate(table.places):
            beyond = at + np.array(offset)
            alive = table.alive[bond >> 6, places] >> np.uint64(bond & 63) & np.uint64(1) != 0
            bonds = alive & curved & self._follows(beyond)
            here, there, length = places[bonds], places[bonds] + distance, float(np.linalg.norm(xi[bond]))
            stretches = []
            for level in levels:
                eta = level[:, there] - level[:, here]
                e = (eta * (2 * xi[bond][:, None] + (eta if table.nonlinear else 0))).sum(0) / length**2
                stretches.append(e / (1 + np.sqrt(1 + e)) if table.nonlinear else e / 2)
            histories = table.history[bond :: len(table.places), here].astype(float)
            energy = np.zeros(len(here))
            of_function(*stretches, *histories, energy, table.parameters[1], length, *table.parameters[2:])
            if table.closing.size:  # those that are shorter are springs, among the other bonds
                energy[(stretches[0] < 0) & (stretches[1] < 0)] = 0
            outside = ((beyond < first) & full[:, 0] | (beyond >= end) & full[:, 1]).any(1)[bonds]
            energy *= factors_of(engine.tables.material, here, there) * np.where(outside, 1.0, 0.5)
            total += float(table.table[bond, -1]) * length**2 * energy.sum()
        return total

    def _follows(self, at: np.ndarray) -> np.ndarray:
        """Which nodes of the box, shape (n, 3), or beyond it, lie where bonds follow the law."""
        zone = self.table.zone
        first = zone[laws.LAW_FIRST : laws.LAW_FIRST + 3]
        return np.asarray(((at >= first) & (at < first + zone[laws.LAW_EXTENT : laws.LAW_EXTENT + 3])).all(1))

    def largest_strain(self) -> float:
        """Largest ``|xi + eta|^2 / |xi|^2 - 1`` (linearised: ``2 xi . eta / |xi|^2``) of the bonds that may break,
        divided by their relative strengths if these vary. For bonds that break by energy, a uniform strain at which as
        much would be lost.
        """
        engine, tables = self.engine, self.engine.tables
        engine.complete(engine.current)
        if engine.passes is None or not len(self.table.released):
            return float(laws.largest_strain(engine.current, tables.sweep.block, engine.components, self.table))
        engine.passes.states_of(engine.current, thermal=True, halo=True)
        passes = tables.gradient_pass, tables.divergence_pass
        medium = StateBonds(tables.sweep, tables.material, *passes, self.table)
        return self.limit * float(np.sqrt(largest_energy(engine.current, medium)))

    def present(self, nodes: tuple[slice, ...]) -> np.ndarray:
        """Bits of the bonds that are present and carry something, for the nodes in a part of the core; shape (words,
        *part).
        """
        places = self.engine.core.node_indices()[nodes]
        bits = self.table.alive[:, places]
        for k, distance in enumerate(self.table.places[:, 0] if self.engine.varied else ()):
            factors = factors_of(self.engine.tables.material, places.ravel(), places.ravel() + distance)
            bits[k >> 6, (factors == 0).reshape(places.shape)] &= ~(np.uint64(1) << np.uint64(k & 63))
        return bits

    @property
    def strengths(self) -> np.ndarray:
        """Relative limit of e of bonds between nodes like this one, for all places, or a single number."""
        table = self.table
        if table.stiffness.size == 1:
            return table.strength.copy()
        with np.errstate(divide="ignore", invalid="ignore"):  # without stiffness bonds never break
            root = np.sqrt(np.where(table.strength > 0, table.strength / table.stiffness, 0.0))
        if not table.nonlinear:
            return root
        stretch = (np.sqrt(1 + self.limit) - 1) * root
        return np.asarray(stretch * (2 + stretch) / self.limit)

    @property
    def critical_stretches(self) -> tuple[float, float]:
        """Smallest and largest stretch at which bonds break or begin to soften."""
        strength = self.strengths
        if strength.size > 1:  # it is zero beyond free sides, where no nodes are
            strength = strength[self.engine.core.node_indices()]
        least, largest = (self.limit * float(factor) for factor in (strength.min(), strength.max()))
        if not self.nonlinear or not np.isfinite(self.limit):
            return least / 2, largest / 2
        return float(np.sqrt(1 + least) - 1), float(np.sqrt(1 + largest) - 1)

    @property
    def limit(self) -> float:
        """Largest e at which the weakest bonds do not break; see `set`."""
        return float(self.table.limit[0])


def _sweeps(law: BondLaw, functions: BondFunctions | None) -> tuple[int, int, int]:
    """Addresses of the sweeps of plain tiles and of a damaged one, and of the bound of the stretch."""
    of_intact = law._replace(contact=False, softening=None, surface=0)  # what matters once a bond is absent or softens
    damaged = load_rows("damaged_rows", law=law)[0] if functions is None else function_sweep(law, functions).address
    steep = load_rows("steep_rows", components=law.components, real=law.real)[0]
    return load_rows("intact_rows", law=of_intact)[0], damaged, steep
