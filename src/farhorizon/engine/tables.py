"""Tables that the kernels of the compiled loop take: named tuples of plain arrays, see `layout.with_defaults`."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.layers import Layers
from farhorizon.engine.layout import empty, ints, reals
from farhorizon.engine.point_law import PointLaw


class Stage(NamedTuple):
    """One stage of a step: ``out = a*src + b*base + scale*L(src)`` on all nodes; components follow each other in a
    level.
    """

    src: np.ndarray
    base: np.ndarray
    out: np.ndarray
    part: int = 0  # number of the stage in its step
    a: Any = 1  # factor of a node's own value in the compiled rows, whose weights leave out the node itself
    a_difference: Any = 1  # the same in sums over differences; with increments both are the increment's part of it
    b: Any = 1
    scale: Any = 1
    increments: bool = False  # whether `base` holds the increment ``out - src``, which the stage updates
    components: int = 1  # of `src`
    rows: int = 1  # components of `base` and `out`
    backward: bool = False  # whether the last part of the box is swept first


class Sweep(NamedTuple):
    """The stencil, and the box of nodes that it is applied to."""

    block: np.ndarray  # see `layout.BOX_FIELDS`
    function: int  # address of the compiled rows; 0 if the stencil has none
    blocks: int  # calls of these rows: the fields are divided into as many equal parts, one after the other
    depth: int  # rows that are swept at a time
    weights: np.ndarray  # of the compiled rows, shape (stages, n)
    offsets: np.ndarray  # distances to the neighbours in a level, shape (K,)
    general: np.ndarray  # weights of the neighbours, then of a reaction matrix; shape (stages, (K or K + 1) * d**2)
    reach: np.ndarray  # shape (3,)
    law: PointLaw = empty(PointLaw)  # law that nodes apply to the sums; without values if the sums are the result


class Material(NamedTuple):
    """Coefficients of the nodes, from which the factors of bonds follow."""

    coefficient: np.ndarray  # at all places of a level; one value if all bonds are equal
    rule: int  # see `bonds.bond_factor`
    interface: Any  # factor of bonds between two phases
    ceiling: Any  # value above which no node's value counts there


class Media(NamedTuple):
    """Where a varying medium is uniform within reach, see `engine.media`."""

    function: int = 0  # address of the compiled rows; 0 if the medium does not vary or is uniform nowhere
    # First row, last + 1, first node and last + 1 in these rows, number of their medium; -1 where bonds differ, a
    # range that may include nodes of other pieces.
    pieces: np.ndarray = ints(0, 5)
    ranges: np.ndarray = ints(1)  # first piece of each part of the box (see `sweep_program.rows_of`) and the end
    mixed: np.ndarray = np.ones(1, np.int8)  # for each place of a level, 1 where bonds differ; one value without media
    weights: np.ndarray = reals(0, 0, 0)  # of the compiled rows, shape (media, stages, n)
    own: np.ndarray = reals(0, 0)  # additions to `Stage.a`, shape (media, stages)


class Cuts(NamedTuple):
    """Absent bonds: places of their nodes and neighbours, sorted, and the weights that are subtracted."""

    nodes: np.ndarray = ints(0)
    neighbours: np.ndarray = ints(0)
    weights: np.ndarray = reals(0)


class Surface(NamedTuple):
    """Weights that nodes at the surface of a body lack, in the form of `surface.shared_rows`."""

    ranges: np.ndarray = ints(0, 2)
    segments: np.ndarray = ints(0, 3)
    weights: np.ndarray = reals(0)
    function: int = 0  # address of the `rows.matrices.linear_map` that adds them; 0 if there are none


class Pass(NamedTuple):
    """Sums over bonds, from a field of `columns` components to one of `rows`."""

    sweep: Sweep
    layers: Layers
    columns: int
    rows: int
    cuts: Cuts = empty(Cuts)
    surface: Surface = empty(Surface)


GENERAL, FACE, EDGE, ABSENT = range(4)  # indices of `Sums.called`


class Sums(NamedTuple):
    """A `Pass` for the operations of the loop, and what computing its sums needs."""

    sweep: Sweep
    layers: Layers
    columns: int
    rows: int
    cuts: Cuts
    surface: Surface
    material: Material  # coefficients of all nodes
    liquid: Material  # of those in and beside layers, where all is liquid
    media: Media
    work_space: np.ndarray  # shape (threads, n)
    # Addresses of functions that operations call with a stage, these sums and numbers: rows of a stencil without
    # compiled ones, and for layers an item of a face, an edge, and absent bonds.
    called: np.ndarray
    # Addresses of functions that are called one after the other with each part of the box, and of their tables: as it
    # is swept, and while messages are under way; shape (n, 2).
    each: np.ndarray
    ahead: np.ndarray
    free: np.ndarray  # rows swept while messages are under way: first and end along the first two axes, shape (2, 2)


class Tables(SimpleNamespace):
    """Everything that the loop reads and keeps, except for the levels and the inputs: what follows, and the tables of
    all features (`engine.feature_list`) by their names. They are not changed, but replaced.
    """

    rotation: np.ndarray  # numbers of the levels (src, base, out), shape (rotations, stages, 3)
    numbers: np.ndarray  # (a, a for differences, b, scale, source scale) of each stage, shape (stages, 5)
    increments: bool
    components: int
    sweep: Sweep
    layers: Layers
    work_space: np.ndarray  # shape (threads, n)
    copies: np.ndarray  # runs of places of the halo that copy others, see `Layout.copies`; shape (3, n)
    material: Material
    gradient_pass: Pass
    divergence_pass: Pass
    pushes: Pass
    traces: Pass
    neighbours: Pass
    operations: tuple[tuple[tuple[str, int, int], ...], ...]  # of each stage, see `engine.passes`
    # Messages by which other processes fill halos, by kind and axis; see `engine.exchange`; shape (kinds, 3, 5).
    exchange: np.ndarray
    # Rows that need no halo from other processes except along the last axis: first and end along the other axes.
    free: np.ndarray
    media: Media
    cuts: Cuts
    surface: Surface
    stretches: Any  # `derivative_pml.DerivativePML`
    bonds: Any  # `bonds.Bonds`

    def replaced(self, **tables: Any) -> Tables:
        """Return the same tables except for some."""
        return Tables(**vars(self) | tables)


class Asked(NamedTuple):
    """The inputs that there are: on them, and on the tables, the operations of a step depend."""

    has_sources: bool = False
    held: bool = False
    recorded_nodes: bool = False
    pushed: bool = False


class Inputs(NamedTuple):
    """Inputs of a number of steps, and what is recorded; S source nodes, J source fields, H held nodes."""

    before: np.ndarray  # number of steps done before, shape (1,)
    source_nodes: np.ndarray  # shape (S,)
    source_fields: np.ndarray  # shape (J, S)
    source_times: np.ndarray  # amplitudes of the fields, shape (steps, stages, J)
    held: np.ndarray  # nodes with the values ``held_values[step]`` after each step, shape (H,)
    held_values: np.ndarray  # shape (steps, H)
    # Constraint forces in each step per unit mass of a node of the medium, which the loop writes; (0, 0) unless wanted.
    held_forces: np.ndarray
    dependent_fields: np.ndarray  # added to the values of `Dependents`, shape (M, n)
    dependent_times: np.ndarray  # amplitudes of these fields, shape (steps, stages, M)
    # Displacements of the shapes with prescribed paths after each step, of those that move freely anything, and what is
    # recorded of all of them before it: displacement, velocity, force that it exerts and energy of its contact, the
    # latter two per mass of a node of the medium; shapes (steps, n, d) and (steps, n, 3 d + 1), or (0, 0, 0).
    impactor_paths: np.ndarray
    impactor_values: np.ndarray
    # Runs of neighbouring nodes whose values are copied to ``node_values[step]`` after each step, sorted: place of the
    # first in its component, its place in the level, its column, and their number; shape (W, 4).
    recorded_nodes: np.ndarray
    node_values: np.ndarray  # shape (steps, columns)
    block_values: np.ndarray  # sums of `BlockSums` after each step, shape (steps, R)
    stride: int  # both are written only in steps whose number in the run is a multiple of it
