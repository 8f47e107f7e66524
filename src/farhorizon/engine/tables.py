"""What all kernels of the compiled loop are given: named tuples of plain arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.point_law import PointLaw


class Stage(NamedTuple):
    """One stage of a step: ``out = a*src + b*base + scale*L(src)`` on all nodes.

    Attributes
    ----------
    src, base, out : ndarray
        Levels, laid out by `farhorizon.engine.layout`. Of a field of several components each holds as many copies of
        the layout, one after the other.
    part : int
        Number of the stage in its step.
    a, a_difference, b, scale : float
        `a` is the factor of a node's own value in the compiled rows, whose weights leave the node itself out, and
        `a_difference` that in sums over differences; of increments both are what the increment takes of the value.
    increments : bool
        Whether `base` holds the increment ``out - src``, which the stage renews.
    components, rows : int
        Of `src`, and of `base` and `out`.
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
    """The stencil, and the box of all nodes that it is swept over.

    Attributes
    ----------
    block : ndarray of int
        See `layout.BOX_FIELDS`.
    function : int
        Address of the compiled rows; 0 for a stencil without.
    blocks : int
        How often they are called: what is read and written falls into so many equal parts, one after the other.
    depth : int
        Rows that are swept at a time.
    weights : ndarray, shape (stages, n)
        Of the compiled rows.
    offsets : ndarray of int, shape (K,)
        Distances to the neighbours in a level.
    general : ndarray, shape (stages, K * components**2), or (stages, (K + 1) * components**2)
        Weights of the neighbours, and what a reaction that is a matrix adds of the nodes' own values.
    reach : ndarray of int, shape (3,)
    law : PointLaw
        What nodes make of the sums; without values where these are all.
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
    """Coefficients of the nodes, from which bonds have their factors.

    Attributes
    ----------
    coefficient : ndarray
        On every place of a level; of one number where all bonds are alike.
    rule : int
        See `bonds.bond_factor`.
    interface, ceiling : float
        Of two phases: the factor of bonds between them, and the value above which none counts there.
    """

    coefficient: np.ndarray
    rule: int
    interface: Any
    ceiling: Any


class Media(NamedTuple):
    """Where a medium that varies is uniform as far as bonds reach, see `engine.media`.

    Attributes
    ----------
    function : int
        Address of the compiled rows; 0 where the medium does not vary, or is nowhere uniform.
    pieces : ndarray of int, shape (P, 5)
        First row and row after the last, first node and node after the last in these rows, and the number of the medium
        there; -1 where bonds differ, in which there may be nodes of other pieces.
    ranges : ndarray of int, shape (parts + 1,)
        First piece of each part of the box (see `program.rows_of`).
    mixed : ndarray of int8
        On every place of a level, 1 where bonds differ; without media one number, 1.
    weights : ndarray, shape (media, stages, n)
        Of the compiled rows.
    own : ndarray, shape (media, stages)
        What is to be added to a node's own factor, `Stage.a`.
    """

    function: int
    pieces: np.ndarray
    ranges: np.ndarray
    mixed: np.ndarray
    weights: np.ndarray
    own: np.ndarray


def one_medium(real: np.dtype) -> Media:
    """None beside that of the stencil."""
    nothing, none = np.zeros((0, 0, 0), real), np.zeros((0, 5), np.int64)
    return Media(0, none, np.zeros(1, np.int64), np.ones(1, np.int8), nothing, np.zeros((0, 0), real))


class Cuts(NamedTuple):
    """Bonds that are absent: places of their nodes and neighbours, sorted, and the weights that are taken away."""

    nodes: np.ndarray
    neighbours: np.ndarray
    weights: np.ndarray


class Surface(NamedTuple):
    """What nodes at the edge of a body lack, see `farhorizon.engine.surface.shared_rows`.

    Attributes
    ----------
    ranges : ndarray of int, shape (rows, 2)
        Stretches of each row of the box: first, last + 1.
    stretches : ndarray of int, shape (n, 3)
        First node in its row, last + 1, and of `weights` the first of its own.
    weights : ndarray
        Those of each stretch, entry by entry of their matrices.
    function : int
        Address of what adds them, see `farhorizon.engine.rows.linear_maps.linear_map`; 0 where there is nothing to add.
    """

    ranges: np.ndarray
    stretches: np.ndarray
    weights: np.ndarray
    function: int


GENERAL, FACE, EDGE, ABSENT = range(4)  # of what is called by operations


class Sums(NamedTuple):
    """Sums over bonds as the operations of the loop take them: those of a pass (`operations.Pass`), and what they need.

    Attributes
    ----------
    material, liquid : Material
        Of all nodes, and of those in and beside layers, where all is liquid.
    media : Media
        Where these are alike.
    work_space : ndarray, shape (threads, n)
    called : ndarray of int, shape (4,)
        Addresses of what operations call with a stage, these sums and numbers: rows of a stencil that has no compiled
        ones, and of layers an item of a face, an edge, and absent bonds.
    each, ahead : ndarray of int
        Addresses of what is done with each part of the box, one after the other: as it is swept, and while messages are
        on their way.
    free : ndarray of int, shape (2, 2)
        The rows that have been swept meanwhile: first and end along the first two axes.
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
    """Nodes of an absorbing zone: factors of the old and of the new increment, and a rate of loss."""

    nodes: np.ndarray
    before: np.ndarray
    after: np.ndarray
    leak: np.ndarray


class Dependents(NamedTuple):
    """Nodes whose values depend on those of others: node i is the sum of weights[k] times node sources[k], k from
    starts[i] to starts[i + 1], plus what comes from outside. They are set in this order.
    """

    nodes: np.ndarray
    starts: np.ndarray
    sources: np.ndarray
    weights: np.ndarray


class Flows(NamedTuple):
    """What flows into the near field, summed over time in some accounts.

    Attributes
    ----------
    accounts, nodes, neighbours : ndarray of int, shape (n,)
        Of each bond: the account, its node, and the neighbour, below 0 where that is at zero.
    weights : ndarray, shape (n,)
    effects : ndarray, shape (stages,)
        What the flow of each stage adds to a step's.
    ends : ndarray of int, shape (ends, K)
        Accounts of the drivers of exact ends, below 0 for none.
    sides : ndarray of int, shape (n, 4)
        Of layers: axis, account, and the first and last + 1 of `beside`.
    beside : ndarray of int
        Nodes next to layers.
    inflow : ndarray
        A level to work in, empty without layers.
    totals : ndarray, shape (2, accounts)
        The sums, and the rounding of them (Neumaier).
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
    """None: nothing is added up."""
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
    """What comes from outside in some steps, and what is watched.

    Attributes
    ----------
    before : int
        Steps that were done before.
    source_nodes : ndarray of int, shape (S,)
    source_fields : ndarray, shape (J, S)
    source_times : ndarray, shape (steps, stages, J)
        Amplitudes of the fields.
    held : ndarray of int, shape (H,)
        Nodes with the values ``held_values[step]`` after each step.
    held_values : ndarray, shape (steps, H)
    dependent_fields, dependent_times : ndarray, shapes (M, n), (steps, stages, M)
        What is added to the values of `Dependents`.
    watched : ndarray of int, shape (W, 4)
        Runs of neighbouring nodes whose values are copied to ``seen[step]`` after each step, sorted: the first one's
        place in its component, its place in the level, its column, and their number.
    seen : ndarray, shape (steps, columns)
    heard : ndarray, shape (steps, R)
        The sums of `Listening` after each step.
    stride : int
        Steps whose number, counted from the run's first on, is no multiple of it leave both as they are.
    """

    before: int
    source_nodes: np.ndarray
    source_fields: np.ndarray
    source_times: np.ndarray
    held: np.ndarray
    held_values: np.ndarray
    dependent_fields: np.ndarray
    dependent_times: np.ndarray
    watched: np.ndarray
    seen: np.ndarray
    heard: np.ndarray
    stride: int


class Listening(NamedTuple):
    """Sums over blocks of nodes that are kept after each step: values between nodes, and derivatives.

    Attributes
    ----------
    sets : ndarray of int, shape (S, 4)
        Number of the sums over blocks of one size, and nodes along the axes of these blocks, of the third a whole
        number of vectors of 64 bytes.
    rows : ndarray of int, shape (R, 6)
        Of each sum, set by set and sorted: a place in the middle of the block, in its component; place of the block's
        first node in the level; numbers of its first weights along the axes; and its column.
    weights : ndarray
        Along one axis each: the weight of a node is the product of three. Those that fill the last vector are zero.
        Blocks with equal weights along an axis share them, for to read them takes as long as to read the nodes.
    stride : ndarray of int, shape (3,)
        Distances of neighbours in a level.
    """

    sets: np.ndarray
    rows: np.ndarray
    weights: np.ndarray
    stride: np.ndarray
