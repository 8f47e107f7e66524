"""Properties that every boundary declares, so that no code needs to ask for its class."""

from __future__ import annotations

from collections.abc import Callable, Set
from inspect import isabstract
from typing import Any, ClassVar, Literal

import numpy as np

from farhorizon import kinds
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

Assumption = Literal["one component", "one density", "no reaction", "no drift", "no losses", "one stage"]
# what is true of a side because it has an answer
_ANSWERS = {"endless": "wanted", "stretched": "make_layer", "damped": "damping", "derivatives": "stretches"}


class Side:
    """The condition on one side of the near field: a frozen dataclass in its own file.

    A class overrides only what differs from a wall beyond which everything is fixed at rest. A class that declares that
    the medium continues beyond it (`endless`) must specify by `wanted` how much may be neglected there.

    Attributes
    ----------
    endless : bool
        The medium continues beyond the side, because it has `wanted`: whatever leaves does not return, and data beyond
        it would be missed.
    bonded : bool
        Bonds cross the side.
    periodic : bool
        The field continues periodically beyond the opposite side.
    image : int
        Sign of the mirror image that represents a wall; 0 if there is none.
    held : float or None
        Fixed value of all nodes beyond.
    stretched : bool
        Its nodes form a layer, which `make_layer` returns.
    damped : bool
        Its nodes are damped, because it has `damping`.
    extended : bool
        Its nodes are nodes of the medium, as many as the run needs.
    derivatives : bool
        At its nodes derivatives are stretched, because it has `stretches`, and initial data continue there: only for
        correspondence materials.
    exact : bool
        There is no error except rounding error.
    closing : bool
        A condition along an outline determines the values of the nodes beyond.
    passive : bool
        It never supplies energy, whatever arrives.
    shared : bool
        What lies beyond it is on another process.
    cracks : {"end", "continue", "repeat", "refuse"}
        Treatment of a crack that crosses it: cut as it is given, continued straight along the normal, required to
        re-enter on the opposite side, or refused.
    assumes : set of {"one component", "one density", "no reaction", "no drift", "no losses", "one stage"}
        What it assumes of the medium and of the integrator; "no drift": weights are equal ahead and behind.
    alone : str
        Why it works on a single process only; empty if it does not.
    dims : tuple of int
        The numbers of dimensions in which it is available.
    label : str
        Its label next to a curve: the words of its name, unless given.
    tag : str
        Its `type` in a case file: ``LatticePML`` is "lattice-pml".
    known : dict of str to type
        All sides by name, including user-defined ones.
    target, until, nodes
        As given, None if not given or not applicable to the side: the desired error, the length of the run, the number
        of nodes beyond.
    profile
        Profile of a layer, specified by hand.

    Raises
    ------
    TypeError
        When a side is called endless without `wanted`, stretched without `make_layer`, damped without `damping`, or one
        with derivatives without `stretches`, or has a name that a class of another module has.

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
    stretched: ClassVar[bool] = False
    damped: ClassVar[bool] = False
    extended: ClassVar[bool] = False
    derivatives: ClassVar[bool] = False
    exact: ClassVar[bool] = False
    closing: ClassVar[bool] = False
    passive: ClassVar[bool] = False
    shared: ClassVar[bool] = False
    cracks: ClassVar[Literal["end", "continue", "repeat", "refuse"]] = "refuse"
    assumes: ClassVar[Set[Assumption]] = frozenset({"no drift"})
    alone: ClassVar[str] = ""
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
        for name, verb in _ANSWERS.items():
            answers = getattr(cls, verb) is not getattr(Side, verb)
            if cls.__dict__.get(name) and not answers:
                raise TypeError(f"{cls.__name__}.{name} is true, so that the class needs a method {verb!r}")
            setattr(cls, name, answers)
        if cls.damped or cls.derivatives or cls.node_rule is not Side.node_rule:
            cls.assumes = cls.assumes | {"one stage"}
        namesake = Side.known.get(cls.__name__)
        if namesake is not None and namesake.__module__ != cls.__module__:
            raise TypeError(
                f"there is a side {cls.__name__!r} already, in {namesake.__module__}: give yours another name"
            )
        cls.tag = kinds.hyphened(cls.__name__)
        if "label" not in cls.__dict__:
            cls.label = cls.tag.replace("-", " ")
        if offered:
            Side.known[cls.__name__] = cls

    @property
    def held(self) -> float | None:
        """Fixed value of all nodes beyond; None if they have none."""
        return None

    @property
    def open_ended(self) -> bool:
        """Whether the number of nodes beyond is chosen from the length of the run."""
        return False

    @property
    def whole(self) -> bool:
        """Whether its layer is given complete and used as it is."""
        return False

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the side; `default` is that of the
        model.
        """
        raise NotImplementedError

    def calmer(self) -> str:
        """Return what of its kind to use where it grows, in words; empty if there is nothing."""
        return ""

    def width(self, reach: int, spacing: float) -> int:
        """Return the number of nodes of the medium itself that are computed beyond the side, for a stencil of a given
        reach.
        """
        return 0

    def make_layer(self, order: int, stencil: Stencil, coefficient: float, spacing: float, half_width: float) -> Layer:
        """Return the layer of the side for unknown data and run length; see `LatticePML.make_layer`."""
        raise NotImplementedError

    def node_rule(self, axis: int, components: int) -> np.ndarray | None:
        """Return the stiffness and the viscosity per area, of each component of the field, that support the last nodes
        of the near field along an axis, shape (2, components); None if nothing does.
        """
        return None

    def damping(self, order: int, coefficient: float, spacing: float) -> np.ndarray:
        """Return the damping at the side's nodes from the near field outwards, shape (nodes,)."""
        raise NotImplementedError

    def stretches(self, spacing: float, speed: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the rates at which derivatives along the normal, and along the side, are stretched at the side's nodes
        from the near field outwards (1/time), shape (nodes,), and their shift, for a given speed of longitudinal waves.
        """
        raise NotImplementedError

    def as_layer(self, until: float | None, default: float) -> Side:
        """Return the side for a run of the given length, if it is known: itself, unless it is to be chosen. It then is
        an absorbing one that meets the target or that of the model, `default`; a run takes this or the result of
        `as_domain`, whichever is faster.
        """
        return self

    def as_domain(self, until: float | None) -> Side:
        """Return an extended domain for a run of the given length, if it is known, for a side that is to be chosen."""
        return self

    def undamped(self) -> Side:
        """Return the same side without its filter of short waves."""
        return self

    def step_limit(self, order: int, coefficient: float, spacing: float, dim: int) -> float:
        """Return the largest time step that the side itself allows, which limits the default step."""
        return np.inf


def checked_target(target: object, least: float) -> float | None:
    """Return the desired error of a side, if one is given; raise InputError for values that are out of range."""
    if target is None:
        return None
    remedy = "an error over the largest value of the data, such as 1e-5"
    return kinds.number(target, "boundary.target", least=least, most=0.1, remedy=remedy, beyond=remedy)


def names(serves: Callable[[type[Side]], bool]) -> str:
    """Return the names of the sides for which `serves` holds, for messages."""
    return ", ".join(sorted(name for name, side in Side.known.items() if not isabstract(side) and serves(side)))
