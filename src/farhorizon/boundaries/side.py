"""What every boundary tells of itself, so that nobody asks of which class it is."""

from __future__ import annotations

from collections.abc import Callable
from inspect import isabstract
from typing import Any, ClassVar, Literal

import numpy as np

from farhorizon import kinds
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil


class Side:
    """What stands on one side of the near field: a frozen dataclass in a file of its own.

    It answers where it differs from a wall that holds what lies beyond it at rest. A class that says that the medium
    goes on beyond it (`endless`) must tell by `wanted` what may be missed there.

    Attributes
    ----------
    endless : bool
        The medium goes on beyond the side: what leaves does not come back, and data beyond would be missed.
    bonded : bool
        Bonds cross the side.
    periodic : bool
        The field repeats itself beyond the opposite side.
    image : int
        Sign of the image that stands for a wall; 0 where none does.
    held : float or None
        Value of all nodes beyond.
    uniform : bool
        The medium goes on along the normal as at the edge, where it must not vary.
    stretched : bool
        Its nodes are those of a layer, which `make_layer` gives.
    damped : bool
        Its nodes are damped by `damping`.
    extended : bool
        Its nodes are as many of the medium as the run needs.
    undecided : bool
        A run takes in its place what `as_layer` or `as_domain` gives, whichever takes less time.
    derivatives : bool
        On its nodes derivatives are stretched, see `stretches`, and initial data go on there:
        correspondence materials alone have them.
    exact : bool
        Nothing is left over but rounding.
    closing : bool
        A condition along an outline gives the nodes beyond their values.
    passive : bool
        Whatever comes to it, it gives no energy.
    shared : bool
        Another process has what lies beyond it.
    cracks : {"end", "continue", "repeat", "refuse"}
        What becomes of a crack that crosses it: it is cut as it is given, goes on straight along the normal, has to
        come back in on the opposite side, or none may.
    vectors : bool
        Fields of several components have it.
    reactive : bool
        Media whose stencil has a reaction have it.
    dims : tuple of int
        The numbers of dimensions that have it.
    label : str
        What it is called beside a curve: the words of its name, unless given.
    tag : str
        Its `type` in a case file: ``LatticePML`` is "lattice-pml".
    known : dict of str to type
        All sides by name, those that users define among them.
    target, until, nodes
        As they are given, None where nothing is or the side knows no such thing: the wanted error, the length of the
        run, the nodes beyond.
    profile
        Of a layer, by hand.

    Raises
    ------
    TypeError
        At the definition of an endless side without `wanted`, of a stretched one without `make_layer`, of a damped one
        without `damping`, of one with derivatives without `stretches`, of an undecided one without `as_layer` or
        `as_domain`, or of one with the name of another module's.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Sponge.endless, fh.Free.bonded, fh.Periodic.periodic, fh.Fixed.image
    (True, False, True, -1)
    >>> fh.LatticePML.tag  # in a case file
    'lattice-pml'
    """

    endless: ClassVar[bool] = False
    bonded: ClassVar[bool] = True
    periodic: ClassVar[bool] = False
    image: ClassVar[int] = 0
    uniform: ClassVar[bool] = False
    stretched: ClassVar[bool] = False
    damped: ClassVar[bool] = False
    extended: ClassVar[bool] = False
    undecided: ClassVar[bool] = False
    derivatives: ClassVar[bool] = False
    exact: ClassVar[bool] = False
    closing: ClassVar[bool] = False
    passive: ClassVar[bool] = False
    shared: ClassVar[bool] = False
    cracks: ClassVar[Literal["end", "continue", "repeat", "refuse"]] = "refuse"
    vectors: ClassVar[bool] = True
    reactive: ClassVar[bool] = True
    dims: ClassVar[tuple[int, ...]] = (1, 2, 3)
    label: ClassVar[str]
    tag: ClassVar[str]
    known: ClassVar[dict[str, type[Side]]] = {}
    target: float | None = None
    until: float | None = None
    nodes: int | None = None
    profile: Any = None

    def __init_subclass__(cls, offered: bool = True, **options: Any) -> None:
        super().__init_subclass__(**options)
        for asked, answer in (
            ("endless", "wanted"),
            ("stretched", "make_layer"),
            ("damped", "damping"),
            ("derivatives", "stretches"),
            ("undecided", "as_layer"),
            ("undecided", "as_domain"),
        ):
            if getattr(cls, asked) and getattr(cls, answer) is getattr(Side, answer):
                raise TypeError(f"{cls.__name__}.{asked} is true, so that the class needs a method {answer!r}")
        known = Side.known.get(cls.__name__)
        if known is not None and known.__module__ != cls.__module__:
            raise TypeError(f"there is a side {cls.__name__!r} already, in {known.__module__}: give yours another name")
        cls.tag = kinds.hyphened(cls.__name__)
        if "label" not in cls.__dict__:
            cls.label = cls.tag.replace("-", " ")
        if offered:
            Side.known[cls.__name__] = cls

    @property
    def held(self) -> float | None:
        """Value of all nodes beyond; None where they have no fixed one."""
        return None

    @property
    def open_ended(self) -> bool:
        """Whether it follows from the length of the run."""
        return False

    def wanted(self, default: float) -> float:
        """What may be missed beyond the side, as a part of the largest value; `default` is that of the model."""
        raise NotImplementedError

    def width(self, reach: int, spacing: float) -> int:
        """Nodes of the medium itself that are computed beyond the side, over a stencil of a reach."""
        return 0

    def make_layer(self, order: int, stencil: Stencil, coefficient: float, spacing: float, half_width: float) -> Layer:
        """The layer of the side, before anything is known of data and run; see `LatticePML.make_layer`."""
        raise NotImplementedError

    def damping(self, order: int, coefficient: float, spacing: float) -> np.ndarray:
        """Damping on the side's nodes from the near field outwards, shape (nodes,)."""
        raise NotImplementedError

    def stretches(self, spacing: float, speed: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Rates at which derivatives along the normal, and along the side, are stretched on the side's nodes from the
        near field outwards (1/time), shape (nodes,), and their shift, for a speed of longitudinal waves.
        """
        raise NotImplementedError

    def as_layer(self, until: float | None, default: float) -> Side:
        """An absorbing side for a run of a length, as far as it is known, that keeps the target or that of the model,
        `default`.
        """
        raise NotImplementedError

    def as_domain(self, until: float | None) -> Side:
        """An extended domain for a run of a length, as far as it is known."""
        raise NotImplementedError

    def undamped(self) -> Side:
        """The same side without a filter of short waves."""
        return self

    def step_limit(self, order: int, coefficient: float, spacing: float, dim: int) -> float:
        """Time step that the side itself bears, which the default step goes by."""
        return np.inf


def checked_target(target: object, least: float) -> float | None:
    """An error that is wanted of a side, if there is one; InputError for what none keeps or nobody needs."""
    if target is None:
        return None
    remedy = "an error over the largest value of the data, such as 1e-5"
    return kinds.number(target, "boundary.target", least=least, most=0.1, remedy=remedy, beyond=remedy)


def names(serves: Callable[[type[Side]], bool]) -> str:
    """Names of the sides that serve, for messages."""
    return ", ".join(sorted(name for name, kind in Side.known.items() if not isabstract(kind) and serves(kind)))
