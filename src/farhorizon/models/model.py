"""What the models share: a stencil and the constant in front of it. (Only `Elastic` has a field of several
components.)"""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray

from farhorizon import kinds
from farhorizon.errors import InputError, shown, suggestion
from farhorizon.files.html import table
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.integrators import Euler, Integrator, RungeKutta4, RungeKuttaChebyshev, Verlet
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.scatter import Weibull
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation

#: Values by which nodes are put in order, and constants of theirs by name.
Ordered = tuple[np.ndarray, dict[str, np.ndarray]]
#: Of a material: a number, or an expression, a function of the coordinates or values at the nodes.
Constant = float | str | Weibull | Callable[..., Any] | NDArray[np.float64]
_TAKEN = ("type", "stencil", "stages", "of")  # keys of its table that are not the class's own


class BondLaw(Protocol):
    """Bonds that follow a law of their own stretch one by one."""

    nonlinear: bool
    contact: bool
    warm: bool
    density: float
    softening: str | None
    fracture_energy: Any
    energy_factor: float | None

    @property
    def p_modulus(self) -> float:
        """Modulus of longitudinal waves."""

    @property
    def caution(self) -> str | None:
        """What cracks in it may do that none does in a continuum."""

    def critical_stretch_on(self, spacing: float, dim: int, strength: Any = 1.0, stiffness: Any = 1.0) -> Any:
        """The stretch at which bonds break, or begin to soften; infinite where none does. Where the medium varies, that
        at the nodes, from the strengths and the factors on bonds over those of the model.
        """

    def bond_stiffness(self, stencil: Stencil, spacing: float) -> np.ndarray:
        """Force density over elongation of each bond of the stencil."""


class Dissolution(Protocol):
    """A solid that becomes liquid where its concentration has fallen below the saturation."""

    saturation: float
    interface: float
    limited: bool

    def speed(self, spacing: float, dim: int, metal: float, far: float = 0.0) -> float:
        """Speed of a plane front (length / time)."""


class LatticeModel:
    """A linear model of one field u, a scalar unless its stencil has matrices, whose operator is ``coefficient * L``.

    A model is a class that derives from it, and thereby known to case files and checkpoints. Its ``__init__`` sets
    `coefficient` and `integrator`, and whatever else of the following differs, and keeps each of its parameters, which
    are the keys in a case file, as an attribute of that name.

    Attributes
    ----------
    coefficient : float
        Squared speed or diffusivity.
    damping : float
        d in ``2 d u_t`` (1/time), second-order models only.
    drag : float
        Rate at which the velocity of a node moves towards the mean of its neighbours (1/time).
    reaction : float
        r in ``- r (u - background)`` on the right-hand side, 1/time or, of second order, 1/time^2; not below zero.
    integrator : Verlet, Euler, RungeKutta4 or RungeKuttaChebyshev
    source_factor : float
        Factor on sources: 1, or what turns power into a rate of temperature.
    combinations : str
        What goes together with which sides, for messages.
    bonds : bool
        Whether the operator is bonds alone, which may be weakened one by one.
    strongest : float
        Largest factor that the model itself puts on bonds.
    mechanical : bool
        Whether loads and tractions act on it.
    warm : bool
        Whether heat strains it, see `heated`.
    heat_capacity : float or None
        Heat per volume and temperature, where its field is a temperature.
    of_temperature : LatticeModel or None
        The model of a temperature that is its second field; None where there is one field alone.
    speed_ratio : float
        Of the fastest long waves to the slowest.
    target : float
        Error that sides keep unless they are given one: of waves relative to the largest value, of diffusion to the
        largest at the same time.
    others : dict of str to str
        What to do instead of giving it some arguments of other models, for messages.
    tag : str
        Its `type` in a case file: ``KleinGordon`` is "klein-gordon".
    known : dict of str to type
        All models by name, those that users define among them.

    Raises
    ------
    InputError
        At the definition of a class that cannot have set the first two, has parameters that cannot be given by name, or
        is called as another.

    Examples
    --------
    >>> import farhorizon as fh
    >>> isinstance(fh.Wave(fh.Kernel(2.0)), fh.LatticeModel), fh.Wave.tag
    (True, 'wave')
    """

    coefficient: float
    damping: float = 0.0
    drag: float = 0.0
    reaction: float = 0.0
    integrator: Integrator
    source_factor: float = 1.0
    combinations: str = ""
    bonds: bool = True
    strongest: float = 1.0
    mechanical: bool = False
    warm: bool = False
    heat_capacity: float | None = None
    of_temperature: LatticeModel | None = None
    speed_ratio: float = 1.0
    target: float = 1e-5
    others: ClassVar[Mapping[str, str]] = {}
    tag: ClassVar[str]
    known: ClassVar[dict[str, type[LatticeModel]]] = {}
    _given: Stencil | None = None  # in place of what follows from the operator
    _stronger: float = 1.0  # bonds over those of the operator

    def __init__(self, operator: Kernel | Stencil) -> None:
        self.operator = kinds.instance(
            operator, "model", (Kernel, Stencil), "a Kernel or a Stencil", remedy="Kernel(horizon=3*spacing)"
        )

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        sets = cls.__init__ is not LatticeModel.__init__ or hasattr(cls, "__post_init__")
        missing = [name for name in ("coefficient", "integrator") if not (sets or hasattr(cls, name))]
        if missing:
            words = f"the model {cls.__name__} has no {' and no '.join(missing)}"
            raise InputError(words, remedy="set them in __init__")
        for name, one in inspect.signature(cls.__init__).parameters.items():
            if name in _TAKEN or one.kind not in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY):
                raise InputError(
                    f"the model {cls.__name__} has a parameter that a case file cannot give by its name",
                    value=str(one),
                    remedy="give it another name" if name in _TAKEN else "name each parameter",
                )
        cls.tag = kinds.hyphened(cls.__name__)
        mine = f"{cls.__module__}.{cls.__name__}"
        tags = {f"{one.__module__}.{one.__name__}": one.tag for one in LatticeModel.known.values()}
        for other, tag in tags.items():
            if tag == cls.tag and other != mine:
                words = f"there is a model {tag!r} already"
                raise InputError(words, value=other, remedy="give yours another name")
        LatticeModel.known[cls.__name__] = cls
        if "__init__" in vars(cls):
            setattr(cls, "__init__", _named(cls.__init__))  # noqa: B010 (mypy lets nobody assign to it)

    @property
    def _parameters(self) -> list[tuple[str, str]]:
        return [(name, shown(getattr(self, name, None))) for name in inspect.signature(type(self)).parameters]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value}' for name, value in self._parameters)})"

    def _repr_html_(self) -> str:
        return table(self._parameters, self.title)

    def check(self) -> None:
        """Refuse a model whose ``__init__`` has left something out.

        Raises
        ------
        InputError
            It names what is missing.
        """
        asked = ["integrator", *([] if self.uneven else ["coefficient"]), *inspect.signature(type(self)).parameters]
        missing = [name for name in asked if not hasattr(self, name)]
        if missing:
            raise InputError(
                f"{self.title} has not kept what a model answers by",
                value=", ".join(missing),
                key="model",
                remedy=f"self.{missing[0]} = ... in __init__",
            )
        if not self.uneven:
            kinds.number(self.coefficient, "model.coefficient", above=0)
        kinds.instance(self.integrator, "model.integrator", get_args(Integrator), "a time integrator")

    @property
    def varying(self) -> dict[str, Any]:
        """Constants of the material that vary from node to node, by name, as they are given."""
        return {}

    @property
    def uneven(self) -> dict[str, Any]:
        """Those of them that its waves feel."""
        return self.varying

    def with_constants(self, constants: Mapping[str, Any]) -> Self:
        """The same model with others of its constants `varying`."""
        return self

    @classmethod
    def check_constant(cls, name: str, values: np.ndarray, key: str) -> None:
        """Refuse values of a constant that varies, which stand at a key.

        Raises
        ------
        InputError
        """
        if values.size and not values.min() > 0:
            raise InputError(
                f"the {name} must be positive at every node",
                value=float(values.min()),
                limit="> 0",
                key=key,
                remedy=_instead_of_none(key),
            )
        kinds.check_magnitude(values, key)

    def ordered(self, values: Mapping[str, np.ndarray]) -> list[Ordered]:
        """By what nodes are put in order, and the constants of which the uniform model takes those of the node in the
        middle: the host medium, where that fills most of a lattice.

        Parameters
        ----------
        values : mapping of str to ndarray
            Of each of the constants `varying` its value at the nodes.
        """
        return []

    def beside(self, values: Mapping[str, np.ndarray]) -> Variation:
        """How the medium varies beside this model, which is uniform; see `ordered`."""
        return Variation()

    @property
    def title(self) -> str:
        """What it is called in messages."""
        return type(self).__name__

    @property
    def bond_law(self) -> BondLaw | None:
        """The law that bonds follow one by one; None where the operator is all there is."""
        return None

    def force_states(self, spacing: float, dim: int) -> ForceStates | None:
        """The two passes of which the stencil is the convolution; None where it is bonds alone."""
        return None

    @property
    def cuttable(self) -> bool:
        """Whether bonds may be absent: cut by cracks, beyond free sides and outside a body."""
        return self.bonds

    @property
    def linearised(self) -> LatticeModel:
        """The same model, linear and unbreakable."""
        return self

    def heated(self, coupled: bool = False) -> Self:
        """The same model where heat strains the medium; `coupled`: and what is deformed heats.

        Raises
        ------
        InputError
            Heat strains no such medium.
        """
        raise InputError(
            "heat strains an elastic medium",
            value=self.title,
            key="load",
            limit="Elastic, Correspondence",
            remedy="leave the thermal load out",
        )

    @property
    def dissolution(self) -> Dissolution | None:
        """How its solid dissolves; None where it has none."""
        return None

    @property
    def order(self) -> int:
        """Order of the equation in time."""
        return 2 if isinstance(self.integrator, Verlet) else 1

    @property
    def speeds(self) -> dict[str, float]:
        """Of long waves by what they are called, where the model knows them."""
        return {}

    @property
    def moduli(self) -> tuple[float, float] | None:
        """Lame's first constant and the shear modulus; of a scalar field 0 and what its gradient is multiplied with in
        the flux of energy, ``c^2``. None where the gradient does not tell that flux.
        """
        return 0.0, self.coefficient / self.source_factor

    def serves(self, side: Any) -> bool:
        """Whether a side, of which the class is given, goes with the model: bonds end at it only if they may be cut.

        Parameters
        ----------
        side : type
            A `farhorizon.boundaries.Side`.
        """
        return not side.derivatives and (self.cuttable or side.bonded)

    def step_limit(self, rate: float) -> float:
        """Largest stable time step for the largest rate of the operator (1/time, or 1/time^2 of waves).

        Of a wave of frequency w drag leaves a part s >= 1 - 2 drag dt of the velocity: ``(w dt)^2 < 2 (1 + s)``.
        """
        if not self.drag:
            return self.integrator.step_limit(rate)
        return 2 / (self.drag + float(np.sqrt(self.drag**2 + rate)))

    def crossing(self, length: float, factor: float = 1.0) -> float:
        """Time in which the fastest long wave crosses a length, or in which what diffuses spreads over half of it:
        ``R^2/D``.

        Parameters
        ----------
        length : float
        factor : float
            On the coefficient, of what is stiffer or conducts better than the medium.
        """
        coefficient = factor * self.coefficient
        return length / float(np.sqrt(coefficient)) if self.order == 2 else (length / 2) ** 2 / coefficient

    def with_stencil(self, stencil: Stencil) -> Self:
        """The same model with a stencil, its reaction included, in place of its operator."""
        model = copy.copy(self)
        model._given, model._stronger = stencil, 1.0
        return model

    def scaled(self, factor: float) -> Self:
        """The model of a medium whose bonds are all stiffer, or conduct better, by a factor."""
        model = copy.copy(self)
        model.coefficient = factor * self.coefficient
        model._stronger = factor * self._stronger
        return model

    def medium(self, spacing: float, dim: int) -> Stencil:
        """Dimensionless stencil on a lattice, with the reaction of the model.

        Raises
        ------
        InputError
            As `stencil`; a reaction below zero.
        """
        if self._given is not None:
            return self._given.beside(self._stronger)
        bonds = self.stencil(spacing, dim).beside(self._stronger)
        reaction = kinds.number(self.reaction, "model.reaction", least=0)
        more = reaction * spacing**2 / self.coefficient
        return bonds.with_reaction(bonds.reaction + more * (np.eye(bonds.components) if np.ndim(bonds.reaction) else 1))

    def stencil(self, spacing: float, dim: int) -> Stencil:
        """Dimensionless stencil of the operator on a lattice."""
        if isinstance(self.operator, Kernel):
            return Stencil.from_kernel(self.operator, spacing, dim)
        if self.operator.dim != dim:
            raise InputError("stencil and lattice differ in dimension", value=self.operator.dim, limit=dim, key="model")
        return self.operator


INTEGRATORS: dict[str, Integrator] = {"euler": Euler(), "rk4": RungeKutta4(), "rkc": RungeKuttaChebyshev()}


def first_order(integrator: str | Integrator) -> Integrator:
    """The integrator of a name, or one for equations of first order itself.

    Raises
    ------
    InputError
        An unknown name, or an integrator for waves.
    """
    if isinstance(integrator, Euler | RungeKutta4 | RungeKuttaChebyshev):
        return integrator
    return INTEGRATORS[kinds.one_of(integrator, "model.integrator", INTEGRATORS, "unknown integrator")]


def material_constant(value: Any, key: str, positive: bool = True) -> Any:
    """A constant of a material: a number, positive or not, or what gives it at the nodes as it is.

    Raises
    ------
    InputError
        A number that is not positive, or what is none of these.
    """
    if callable(value) or isinstance(value, str) or (isinstance(value, np.ndarray) and value.ndim):
        return value
    return kinds.number(
        value,
        key,
        above=0.0 if positive else None,
        remedy="a number, an expression, a function or an array of the nodes",
        beyond="" if not positive else _instead_of_none(key) if value == 0 else "a positive number",
    )


def _instead_of_none(key: str) -> str:
    """What stands for a medium, or for a strength, that is not there."""
    if key.endswith(("critical_stretch", "fracture_energy")):
        return "a crack where bonds are cut from the start; leave it out, or give a large one, where none break"
    return "where there is no medium, leave it out of the lattice: body=..."


def _named(init: Callable[..., None]) -> Callable[..., None]:
    """The ``__init__`` of a model, which refuses arguments of other names in words."""
    known = [name for name in inspect.signature(init).parameters if name != "self"]

    @functools.wraps(init)
    def checked(self: LatticeModel, *given: Any, **named: Any) -> None:
        for name, value in named.items():
            if name not in known:
                near = suggestion(name, known).partition("known")[0].strip()
                raise InputError(
                    f"{type(self).__name__} has no such argument",
                    value=kinds.said(value),
                    limit=", ".join(known),
                    key=f"model.{name}",
                    remedy=self.others.get(name) or near or "leave it out",
                )
        init(self, *given, **named)

    return checked
