"""Arguments of the kernels of the compiled loop: named tuples of plain arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.point_law import PointLaw


class Stage(NamedTuple):
    """One stage of a step: ``out = a*src + b*base + scale*L(src)`` on all nodes.

    Attributes
    ----------
    src, base, out : ndarray
        Levels, laid out by `farhorizon.engine.layout`. For a field of several components each holds one copy of the
        layout per component, one after the other.
    part : int
        Number of the stage in its step.
    a, a_difference, b, scale : float
        `a` is the factor of a node's own value in the compiled rows, whose weights leave out the node itself, and
        `a_difference` its factor in sums over differences; with increments both are what the increment takes of the
        value.
    increments : bool
        Whether `base` holds the increment ``out - src``, which the stage updates.
    components, rows : int
        Numbers of components of `src`, and of `base` and `out`.
    backward : bool
        Whether the last part of the box is swept first.
    """

    src: np.ndarray
    base: np.ndarray
    out: np.ndarray
    part: int
    a: Any
    a_difference: Any
    b: Any
    scale: Any
    increments: bool
    components: int
    rows: int
    backward: bool = False


class Sweep(NamedTuple):
    """The stencil, and the box of nodes that it is applied to.

    Attributes
    ----------
    block : ndarray of int
        See `layout.BOX_FIELDS`.
    function : int
        Address of the compiled rows; 0 if the stencil has none.
    blocks : int
        Number of calls of these rows: fields that are read and written are divided into as many equal parts, one after
        the other.
    depth : int
        Rows that are swept at a time.
    weights : ndarray, shape (stages, n)
        Weights of the compiled rows.
    offsets : ndarray of int, shape (K,)
        Distances to the neighbours in a level.
    general : ndarray, shape (stages, K * components**2), or (stages, (K + 1) * components**2)
        Weights of the neighbours; those of a reaction matrix on the nodes' own values follow.
    reach : ndarray of int, shape (3,)
    law : PointLaw
        Law that nodes apply to the sums; without values if the sums are the result.
    """

    block: np.ndarray
    function: int
    blocks: int
    depth: int
    weights: np.ndarray
    offsets: np.ndarray
    general: np.ndarray
    reach: np.ndarray
    law: PointLaw


class Material(NamedTuple):
    """Coefficients of the nodes, from which the factors of bonds follow.

    Attributes
    ----------
    coefficient : ndarray
        Values at all places of a level; one value if all bonds are equal.
    rule : int
        See `bonds.bond_factor`.
    interface, ceiling : float
        For two phases: the factor of bonds between them, and the value above which no node's value counts there.
    """

    coefficient: np.ndarray
    rule: int
    interface: Any
    ceiling: Any


class Media(NamedTuple):
    """Where a varying medium is uniform within reach, see `engine.media`.

    Attributes
    ----------
    function : int
        Address of the compiled rows; 0 if the medium does not vary or is uniform nowhere.
    pieces : ndarray of int, shape (P, 5)
        First row and row after the last, first node and node after the last in these rows, and the number of their
        medium; -1 where bonds differ, a range that may include nodes of other pieces.
    ranges : ndarray of int, shape (parts + 1,)
        First piece of each part of the box (see `program.rows_of`).
    mixed : ndarray of int8
        For each place of a level, 1 where bonds differ; without media a single 1.
    weights : ndarray, shape (media, stages, n)
        Weights of the compiled rows.
    own : ndarray, shape (media, stages)
        Additions to a node's own factor, `Stage.a`.
    """

    function: int
    pieces: np.ndarray
    ranges: np.ndarray
    mixed: np.ndarray
    weights: np.ndarray
    own: np.ndarray


def one_medium(real: np.dtype) -> Media:
    """Return tables without media other than that of the stencil."""
    nothing, none = np.zeros((0, 0, 0), real), np.zeros((0, 5), np.int64)
    return Media(0, none, np.zeros(1, np.int64), np.ones(1, np.int8), nothing, np.zeros((0, 0), real))


class Cuts(NamedTuple):
    """Absent bonds: places of their nodes and neighbours, sorted, and the weights that are subtracted."""

    nodes: np.ndarray
    neighbours: np.ndarray
    weights: np.ndarray


class Surface(NamedTuple):
    """Weights that nodes at the surface of a body lack, see `farhorizon.engine.surface.shared_rows`.

    Attributes
    ----------
    ranges : ndarray of int, shape (rows, 2)
        First stretch of each row of the box, and last + 1.
    stretches : ndarray of int, shape (n, 3)
        First node in its row, last + 1, and the index of its first entry of `weights`.
    weights : ndarray
        Matrices of each stretch, entry by entry.
    function : int
        Address of the function that adds them, see `farhorizon.engine.rows.matrices.linear_map`; 0 if there are
        none.
    """

    ranges: np.ndarray
    stretches: np.ndarray
    weights: np.ndarray
    function: int


GENERAL, FACE, EDGE, ABSENT = range(4)  # indices of `Sums.called`


class Sums(NamedTuple):
    """Sums over bonds for the operations of the loop: those of a pass (`operations.Pass`), and what their computation
    needs.

    Attributes
    ----------
    material, liquid : Material
        Coefficients of all nodes, and of those in and beside layers, where all is liquid.
    media : Media
        Where these are uniform.
    work_space : ndarray, shape (threads, n)
    called : ndarray of int, shape (4,)
        Addresses of functions that operations call with a stage, these sums and numbers: rows of a stencil without
        compiled ones, and for layers an item of a face, an edge, and absent bonds.
    each, ahead : ndarray of int
        Addresses of functions that are called one after the other with each part of the box: as it is swept, and while
        messages are under way.
    free : ndarray of int, shape (2, 2)
        Rows that are swept while messages are under way: first and end along the first two axes.
    """

    sweep: Sweep
    layers: Any
    cuts: Cuts
    surface: Surface
    columns: int
    rows: int
    material: Material
    liquid: Material
    media: Any
    work_space: np.ndarray
    called: np.ndarray
    each: np.ndarray
    ahead: np.ndarray
    free: np.ndarray


class Damping(NamedTuple):
    """Nodes of an absorbing zone: factors of the old and of the new increment, and a loss rate."""

    nodes: np.ndarray
    before: np.ndarray
    after: np.ndarray
    leak: np.ndarray


class Dependents(NamedTuple):
    """Nodes whose values depend on those of others: node i is the sum of weights[k] times node sources[k], k from
    starts[i] to starts[i + 1], plus a value from outside. They are set in this order.
    """

    nodes: np.ndarray
    starts: np.ndarray
    sources: np.ndarray
    weights: np.ndarray


class Flows(NamedTuple):
    """Flows into the near field, integrated over time in a number of accounts.

    Attributes
    ----------
    accounts, nodes, neighbours : ndarray of int, shape (n,)
        Of each bond: the account, its node, and the neighbour, which is negative if its value is zero.
    weights : ndarray, shape (n,)
    effects : ndarray, shape (stages,)
        Factor of the flow of each stage in that of a step.
    ends : ndarray of int, shape (ends, K)
        Accounts of the drivers of exact ends, negative for none.
    sides : ndarray of int, shape (n, 4)
        Of each layer: axis, account, and first and last + 1 of `beside`.
    beside : ndarray of int
        Nodes next to layers.
    inflow : ndarray
        Level for intermediate results, empty without layers.
    totals : ndarray, shape (2, accounts)
        Sums, and their rounding errors (Neumaier).
    """

    accounts: np.ndarray
    nodes: np.ndarray
    neighbours: np.ndarray
    weights: np.ndarray
    effects: np.ndarray
    ends: np.ndarray
    sides: np.ndarray
    beside: np.ndarray
    inflow: np.ndarray
    totals: np.ndarray


def no_flows(stages: int, real: np.dtype) -> Flows:
    """Return tables without accounts."""
    none = np.zeros(0, np.int64)
    return Flows(
        *(none, none, none, np.zeros(0), np.zeros(stages)),
        np.zeros((0, 0), np.int64),
        np.zeros((0, 4), np.int64),
        none,
        np.zeros(0, real),
        np.zeros((2, 0)),
    )


class Inputs(NamedTuple):
    """Inputs of a number of steps, and what is recorded.

    Attributes
    ----------
    before : int
        Number of steps done before.
    source_nodes : ndarray of int, shape (S,)
    source_fields : ndarray, shape (J, S)
    source_times : ndarray, shape (steps, stages, J)
        Amplitudes of the fields.
    held : ndarray of int, shape (H,)
        Nodes with the values ``held_values[step]`` after each step.
    held_values : ndarray, shape (steps, H)
    held_forces : ndarray, shape (steps, H), or (0, 0) unless they are wanted
        Constraint forces on them in each step, per unit mass of a node of the medium, which the loop writes.
    dependent_fields, dependent_times : ndarray, shapes (M, n), (steps, stages, M)
        Fields added to the values of `Dependents`, and their amplitudes.
    recorded_nodes : ndarray of int, shape (W, 4)
        Runs of neighbouring nodes whose values are copied to ``node_values[step]`` after each step, sorted: place of
        the first in its component, its place in the level, its column, and their number.
    node_values : ndarray, shape (steps, columns)
    block_values : ndarray, shape (steps, R)
        Sums of `BlockSums` after each step.
    stride : int
        Both are written only in steps whose number, counted from the first step of the run, is a multiple of it.
    """

    before: int
    source_nodes: np.ndarray
    source_fields: np.ndarray
    source_times: np.ndarray
    held: np.ndarray
    held_values: np.ndarray
    held_forces: np.ndarray
    dependent_fields: np.ndarray
    dependent_times: np.ndarray
    recorded_nodes: np.ndarray
    node_values: np.ndarray
    block_values: np.ndarray
    stride: int


class BlockSums(NamedTuple):
    """Sums over blocks of nodes that are recorded after each step: values between nodes, and derivatives.

    Attributes
    ----------
    sets : ndarray of int, shape (S, 4)
        Number of sums over blocks of one size, and the size of these blocks along the axes; along the third it is a
        whole number of vectors of 64 bytes.
    rows : ndarray of int, shape (R, 6)
        Of each sum, set by set and sorted: place in the middle of the block, in its component; place of the block's
        first node in the level; indices of its first weights along the axes; and its column.
    weights : ndarray
        Weights along each axis: the weight of a node is the product of three. Those that fill up the last vector are
        zero. Blocks with equal weights along an axis share them, because reading weights takes as long as reading
        nodes.
    stride : ndarray of int, shape (3,)
        Distances between neighbours in a level.
    """

    sets: np.ndarray
    rows: np.ndarray
    weights: np.ndarray
    stride: np.ndarray
