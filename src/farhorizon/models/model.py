"""Common base of the models: a stencil and the constant in front of it. (Only `Elastic` has a field of several
components.)
"""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray

from farhorizon import kinds
from farhorizon.arguments import ANY, Function, OfRegions, Unit
from farhorizon.errors import InputError, shown, suggestion
from farhorizon.files.html import table
from farhorizon.medium import bond_laws
from farhorizon.medium.attenuation import Attenuation
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.integrators import Euler, Integrator, ModifiedEquation, RungeKutta4, RungeKuttaChebyshev, Verlet
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.of_field import OfField, names_field
from farhorizon.medium.random_constants import Weibull
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation

#: Values by which nodes are ordered, and their constants by name.
Ordered = tuple[np.ndarray, dict[str, np.ndarray]]
#: Constant of a material: a number, or an expression, a function of the coordinates or values at the nodes.
Constant = Annotated[
    float | str | Weibull | OfField | Callable[..., Any] | NDArray[np.float64], Function(time=False), OfRegions()
]
Density = Annotated[Constant, Unit("kg/m^3")]
Modulus = Annotated[Constant, Unit("Pa")]
_TAKEN = ("type", "stencil", "order", "stages", "of")  # keys in case files that are no parameters of the model


class BondLaw(Protocol):
    """Model whose bonds each have a law of their own stretch."""

    nonlinear: bool
    contact: bool
    friction: float
    shear: float
    warm: bool
    density: float
    softening: str | None
    law: bond_laws.BondLaw | None  # that is a function
    fracture_energy: Any
    energy_factor: float | None
    calibrate: str
    spent_by_running: float | None

    @property
    def p_modulus(self) -> float:
        """Modulus of longitudinal waves."""

    def expansion(self, dim: int) -> float:
        """Return the strain across a body over its compression by forces along one axis."""

    @property
    def slides(self) -> bool:
        """Whether the faces of cracks slide where they are in contact."""

    @property
    def caution(self) -> str | None:
        """Warning about cracks that may behave unlike those in a continuum, or None."""

    def critical_stretch_on(self, spacing: float, dim: int, strength: Any = 1.0, stiffness: Any = 1.0) -> Any:
        """Return the stretch at which bonds break or begin to soften; infinite if none does. Where the medium varies,
        the values at the nodes, from strengths and factors of bonds relative to those of the model.
        """

    def bond_stiffness(self, stencil: Stencil, spacing: float) -> np.ndarray:
        """Return the force density per elongation of each bond of the stencil."""


class Dissolution(Protocol):
    """Solid that becomes liquid where its concentration has fallen below the saturation."""

    saturation: float
    interface: float
    limited: bool

    def speed(self, spacing: float, dim: int, metal: float, far: float = 0.0) -> float:
        """Return the speed of a plane front (length / time)."""


class LatticeModel:
    """A linear model of one field u, a scalar unless its stencil has matrices, with the operator ``coefficient * L``.

    A model is a class that derives from this one and is thereby registered for case files and checkpoints. Its
    ``__init__`` sets `coefficient` and `integrator`, and any of the following that differs from the default, and stores
    each of its parameters, which are the keys in a case file, as an attribute of the same name.

    Attributes
    ----------
    coefficient : float
        Squared speed or diffusivity.
    damping : float
        d in ``2 d u_t`` (1/time), second-order models only.
    drag : float
        Rate at which the velocity of a node relaxes towards the mean of its neighbours (1/time).
    attenuation : Attenuation or None
        How the forces of the medium relax, of linear waves by velocity Verlet; the `coefficient` is then that of waves
        of infinite frequency.
    reaction : float
        r in ``- r (u - background)`` on the right-hand side, in 1/time or, for second-order models, 1/time^2. A
        negative one, of scalar fields, is growth, for which no side absorbs.
    integrator : Verlet, ModifiedEquation, Euler, RungeKutta4 or RungeKuttaChebyshev
    source_factor : float
        Factor on sources: 1, or the factor that converts power into a rate of temperature.
    combinations : str
        Which sides can be combined with the model, for messages.
    bonds : bool
        Whether the operator consists of bonds only, which may be weakened individually.
    strongest : float
        Largest factor that the model itself applies to bonds.
    quantity : str
        What its field is, in words; empty if it may be anything.
    field_unit : str
        SI unit of its field, or `farhorizon.arguments.ANY`.
    mechanical : bool
        Whether loads and tractions can act on it.
    warm : bool
        Whether temperature strains it, see `heated`.
    heat_capacity : float or None
        Heat per volume and temperature, if its field is a temperature; nan where it varies.
    of_temperature : LatticeModel or None
        The model of the temperature, if this is its second field; None if there is only one field.
    speed_ratio : float
        Ratio of the speed of the fastest long waves to that of the slowest.
    target : float
        Target error of the sides unless they are given one: for waves relative to the largest value, for diffusion
        relative to the largest value at the same time.
    constants : tuple of str
        Names of the constants of its material that may vary from node to node, and from which `medium_of` derives what
        the operator needs.
    others : dict of str to str
        What to do instead of passing some arguments of other models, for messages.
    tag : str
        Its `type` in a case file: ``KleinGordon`` is "klein-gordon".
    known : dict of str to type
        All models by name, including user-defined ones.

    Raises
    ------
    InputError
        When a class is defined that cannot have set the first two, has parameters that cannot be given by name, or has
        the name of another model.

    Examples
    --------
    >>> import farhorizon as fh
    >>> isinstance(fh.Wave(fh.Kernel(2.0)), fh.LatticeModel), fh.Wave.tag
    (True, 'wave')
    """

    coefficient: float
    damping: float = 0.0
    drag: float = 0.0
    attenuation: Attenuation | None = None
    reaction: float = 0.0
    integrator: Integrator
    source_factor: float = 1.0
    combinations: str = ""
    bonds: bool = True
    strongest: float = 1.0
    quantity: str = ""
    field_unit: str = ANY
    mechanical: bool = False
    warm: bool = False
    heat_capacity: float | None = None
    of_temperature: LatticeModel | None = None
    speed_ratio: float = 1.0
    target: float = 1e-5
    constants: ClassVar[tuple[str, ...]] = ()
    others: ClassVar[Mapping[str, str]] = {}
    tag: ClassVar[str]
    known: ClassVar[dict[str, type[LatticeModel]]] = {}
    _levels: Mapping[str, float] = {}
    _given: Stencil | None = None  # replaces the stencil of the operator
    _stronger: float = 1.0  # stiffness of bonds relative to those of the operator

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
        for name, parameter in inspect.signature(cls.__init__).parameters.items():
            if name in _TAKEN or parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
                raise InputError(
                    f"the model {cls.__name__} has a parameter that a case file cannot give by its name",
                    value=str(parameter),
                    remedy="give it another name" if name in _TAKEN else "name each parameter",
                )
        cls.tag = kinds.hyphened(cls.__name__)
        mine = f"{cls.__module__}.{cls.__name__}"
        tags = {f"{model.__module__}.{model.__name__}": model.tag for model in LatticeModel.known.values()}
        for name, tag in tags.items():
            if tag == cls.tag and name != mine:
                words = f"there is a model {tag!r} already"
                raise InputError(words, value=name, remedy="give yours another name")
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
            The message names what is missing.
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
        """Constants of the material that vary from node to node, by name, in the form in which they were given."""
        given = {name: getattr(self, name) for name in self.constants}
        return {name: value for name, value in given.items() if not isinstance(value, float | OfField)}

    @property
    def follows(self) -> dict[str, OfField]:
        """Constants of the material that follow the field, by name."""
        given = {name: getattr(self, name) for name in self.constants}
        return {name: value for name, value in given.items() if isinstance(value, OfField)}

    def around(self, levels: Mapping[str, float], strongest: float = 1.0) -> Self:
        """The same model with the values, at the background, of the constants in `follows`, the largest of which is
        `strongest` times as large somewhere.
        """
        model = copy.copy(self)
        model._levels, model.strongest = dict(levels), strongest
        model._set(**{name: getattr(self, name) for name in self.constants})
        return model

    @property
    def at_background(self) -> Self:
        """The same model with the constants in `follows` as at the background."""
        model = copy.copy(self)
        model.strongest = 1.0
        model._set(**{name: getattr(self, name) for name in self.constants} | self._at_background)
        return model

    @property
    def uneven(self) -> dict[str, Any]:
        """The varying constants that affect its waves."""
        return self.varying

    @property
    def wave_constants(self) -> dict[str, Any]:
        """All constants that affect its waves and may vary, by name, in the form in which they were given."""
        return {name: getattr(self, name) for name in self.constants}

    def with_constants(self, constants: Mapping[str, Any]) -> Self:
        """The same model with other values of the constants in `varying`."""
        model = copy.copy(self)
        present = {name: getattr(self, name) for name in self.constants}
        model._set(**present | {name: value for name, value in constants.items() if name not in self.follows})
        return model

    def _set(self, **constants: Any) -> None:
        """Set all `constants`, and what follows from them unless some of them vary."""
        vars(self).update(constants)
        if constants and not self.varying:
            self.coefficient, density = self.medium_of({**constants, **self._at_background})
            self.source_factor = 1 / density

    def medium_of(self, constants: Mapping[str, Any]) -> tuple[Any, Any]:
        """The squared speed, or diffusivity, and the density of a scalar medium of given `constants`: the mass or heat
        capacity per volume by which what acts on a node is divided.
        """
        raise NotImplementedError

    @classmethod
    def check_constant(cls, name: str, values: np.ndarray, key: str) -> None:
        """Refuse inadmissible values of a varying constant, which are given at a key.

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
        """Quantities by which nodes are ordered, each with the constants whose values at the median node define the
        uniform model: the host medium, if it fills most of a lattice.

        Parameters
        ----------
        values : mapping of str to ndarray
            Values at the nodes of each of the constants in `varying`.
        """
        if not self.constants:
            return []
        constants = self._at_nodes(values)
        return [(self.medium_of(constants)[0], constants)]

    def beside(self, values: Mapping[str, np.ndarray]) -> Variation:
        """Variation of the medium relative to this model, which is uniform; see `ordered`."""
        if not self.constants:
            return Variation()
        squared, density = self.medium_of(self._at_nodes(values))
        heavier = density * self.source_factor
        return Variation(heavier * (squared / self.coefficient), heavier if np.ndim(density) else None)

    @property
    def _at_background(self) -> dict[str, float]:
        """Values of the constants in `follows` at the background, 1 where it is not known yet."""
        return {name: self._levels.get(name, 1.0) for name in self.follows}

    def _at_nodes(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """All `constants` at the nodes, given those that vary."""
        constants = {name: getattr(self, name) for name in self.constants} | self._at_background
        at_nodes = np.broadcast_arrays(*(values.get(name, constants[name]) for name in self.constants))
        return dict(zip(self.constants, at_nodes, strict=True))

    def of_ratio(self, lame: float) -> LatticeModel:
        """The same solid with another ratio of Lame's constant to the P modulus; for other models the model itself."""
        return self

    @property
    def title(self) -> str:
        """Name of the model in messages."""
        return type(self).__name__

    @property
    def bond_law(self) -> BondLaw | None:
        """The law that individual bonds follow; None where the operator describes everything."""
        return None

    def force_states(self, spacing: float, dim: int) -> ForceStates | None:
        """The two passes whose convolution is the stencil; None for bonds alone."""
        return None

    @property
    def soft_at_surfaces(self) -> Any:
        """The model itself where it is softer beside free surfaces, beyond which bonds are absent, else None."""
        return None

    @property
    def stiffens_surfaces(self) -> bool:
        """Whether bonds of nodes that lack some are stiffer than others."""
        return False

    @property
    def cuttable(self) -> bool:
        """Whether bonds may be absent: cut by cracks, beyond free sides, or outside a body."""
        return self.bonds

    @property
    def linearised(self) -> LatticeModel:
        """The same model, linear and unbreakable."""
        return self

    def heated(self, coupled: bool = False) -> Self:
        """The same model with thermal strains in the medium and, with `coupled`, heating by its deformation.

        Raises
        ------
        InputError
            Such a medium has no thermal strains.
        """
        raise InputError(
            "thermal strain needs an elastic medium",
            value=self.title,
            key="load",
            limit="Elastic, Correspondence",
            remedy="leave the thermal load out",
        )

    @property
    def dissolution(self) -> Dissolution | None:
        """The dissolution of its solid; None if there is none."""
        return None

    @property
    def order(self) -> int:
        """Order of the equation in time."""
        return self.integrator.equation_order

    @property
    def speeds(self) -> dict[str, float]:
        """Speeds of long waves by the names of the waves, if the model provides them."""
        return {}

    @property
    def moduli(self) -> tuple[float, float] | None:
        """Lame's first constant and the shear modulus; for a scalar field, 0 and the factor of its gradient in the flux
        of energy, ``c^2``. None where the gradient does not determine that flux.
        """
        return 0.0, self.coefficient / self.source_factor

    def serves(self, side: Any) -> bool:
        """Whether a side, given by its class, can be used with the model: bonds may end at it only if they may be cut.

        Parameters
        ----------
        side : type
            A `farhorizon.boundaries.Side`.
        """
        return not side.derivatives and (self.cuttable or side.bonded)

    def step_limit(self, rate: float) -> float:
        """Largest stable time step for the largest rate of the operator (1/time, for waves 1/time^2).

        Drag leaves a fraction s >= 1 - 2 drag dt of the velocity of a wave of frequency w: ``(w dt)^2 < 2 (1 + s)``.
        """
        if not self.drag:
            return self.integrator.step_limit(rate)
        return 2 / (self.drag + float(np.sqrt(self.drag**2 + rate)))

    def crossing(self, length: float, factor: float = 1.0) -> float:
        """Time in which the fastest long wave crosses a length, or in which diffusion spreads over half of it:
        ``R^2/D``.

        Parameters
        ----------
        length : float
        factor : float
            Factor on the coefficient, for parts that are stiffer or conduct better than the medium.
        """
        coefficient = factor * self.coefficient
        return length / float(np.sqrt(coefficient)) if self.order == 2 else (length / 2) ** 2 / coefficient

    def with_stencil(self, stencil: Stencil) -> Self:
        """The same model with a stencil, including its reaction, instead of its operator."""
        model = copy.copy(self)
        model._given, model._stronger = stencil, 1.0
        return model

    def scaled(self, factor: float) -> Self:
        """The model of a medium whose bonds are all stiffer, or conduct better, by a given factor."""
        model = copy.copy(self)
        model.coefficient = factor * self.coefficient
        model._stronger = factor * self._stronger
        return model

    @property
    def by_region(self) -> bool:
        """Whether its attenuation differs from region to region."""
        return self.attenuation is not None and len(self.attenuation.regions) > 0

    def with_one_attenuation(self) -> Self:
        """The same model with the attenuation of its stiffest region everywhere."""
        if self.attenuation is None:
            return self
        model = copy.copy(self)
        model.attenuation = self.attenuation.strongest
        return model

    def medium(self, spacing: float, dim: int) -> Stencil:
        """Dimensionless stencil on a lattice, including the reaction of the model.

        Raises
        ------
        InputError
            As in `stencil`; a negative reaction of a field of several components.
        """
        if self._given is not None:
            return self._given.beside(self._stronger)
        bonds = self.stencil(spacing, dim).beside(self._stronger)
        reaction = kinds.number(self.reaction, "model.reaction", least=None if bonds.components == 1 else 0)
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
    """The integrator with a given name, or a given integrator for equations of first order; an InputError for
    another.
    """
    if isinstance(integrator, Euler | RungeKutta4 | RungeKuttaChebyshev):
        return integrator
    return INTEGRATORS[kinds.one_of(integrator, "model.integrator", INTEGRATORS, "unknown integrator")]


WAVE_INTEGRATORS: dict[str, Integrator] = {"verlet": Verlet(), "modified-equation": ModifiedEquation()}


def second_order(integrator: str | Integrator, damping: float) -> Integrator:
    """The integrator with a given name, or a given integrator for equations of second order; an InputError for another,
    and for damping that it does not have.
    """
    found = integrator
    if not isinstance(integrator, Verlet | ModifiedEquation):
        found = WAVE_INTEGRATORS[kinds.one_of(integrator, "model.integrator", WAVE_INTEGRATORS, "unknown integrator")]
    if damping and isinstance(found, ModifiedEquation):
        raise InputError(
            "the modified equation is that of waves without damping",
            value=damping,
            limit=0,
            key="model.damping",
            remedy='integrator = "verlet"',
        )
    return found  # type: ignore[return-value]


def attenuation_of(value: Any) -> Attenuation | None:
    """An attenuation, or None; an InputError for anything else."""
    if value is None:
        return None
    remedy = "Attenuation(quality=50, band=(0.1, 10.0))"
    return kinds.instance(value, "model.attenuation", Attenuation, "an Attenuation", remedy=remedy)


def material_constant(value: Any, key: str, positive: bool = True, follows: bool = False) -> Any:
    """A constant of a material: a number, positive or not, or, unchanged, anything that gives its values at the nodes,
    or if it may follow the field, an `OfField`; an InputError for anything else.
    """
    if follows and names_field(value):
        return OfField(value)
    if (
        callable(value)
        or isinstance(value, str | OfField if follows else str)
        or (isinstance(value, np.ndarray) and value.ndim)
    ):
        return value
    return kinds.number(
        value,
        key,
        above=0.0 if positive else None,
        remedy="a number, an expression, a function or an array of the nodes",
        beyond="" if not positive else _instead_of_none(key) if value == 0 else "a positive number",
    )


def _instead_of_none(key: str) -> str:
    """Return a hint at how to describe a medium or a strength of zero."""
    if key.endswith(("critical_stretch", "fracture_energy")):
        return "a crack where bonds are cut from the start; leave it out, or give a large one, where none break"
    if key.endswith("shear"):
        return "a fluid alone is a model of type wave; beside a solid give it a shear modulus, 1 % of its bulk"
    return "where there is no medium, leave it out of the lattice: body=..."


def _named(init: Callable[..., None]) -> Callable[..., None]:
    """Wrap the ``__init__`` of a model so that it refuses arguments of other names with a helpful message."""
    parameters = [name for name in inspect.signature(init).parameters if name != "self"]

    @functools.wraps(init)
    def checked(self: LatticeModel, *given: Any, **named: Any) -> None:
        for name, value in named.items():
            if name not in parameters:
                near = suggestion(name, parameters).partition("known")[0].strip()
                raise InputError(
                    f"{type(self).__name__} has no such argument",
                    value=kinds.said(value),
                    limit=", ".join(parameters),
                    key=f"model.{name}",
                    remedy=self.others.get(name) or near or "leave it out",
                )
        init(self, *given, **named)

    return checked
