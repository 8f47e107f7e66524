"""Laws of bonds that are functions, compiled by Numba: the base class, and softening and viscoelastic bonds."""

from __future__ import annotations

import inspect
import math
from abc import ABC
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Duration, Registered
from farhorizon.engine.codegen.bond_functions import GIVEN, OF_STEP, BondFunctions
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable

_NAMES = ("update", "force", "energy", "damage")
#: Stretches at which a law is tried: from rounding errors to a bond that is twice as long, or almost without length.
_LEAST, _LONGEST, _SHORTEST, _TRIALS = 1e-9, 1.0, -0.9, 200
_APART = 1e-3  # relative distance of the stretches between which slopes are compared
#: Words of Numba about arrays and lists where there is no memory for them.
_OF_MEMORY = "NRT required", "Only accept returning of array"
_ROUNDING = 1e-12  # relative error of a function of a few operations


class BondLaw(Registered, Storable, ABC):
    """The law of a bond, by functions of its stretch and its history that Numba compiles.

    A user-defined law is a frozen dataclass that derives from this class. Its fields are numbers, the keys of its table
    in case files. Forces are in units of the bond's stiffness, which follows from the moduli of the solid: a spring has
    ``force = stretch``. The functions are static methods, whose arguments are asked for by name: `stretch`, the
    `length` of the bond, numbers from `history`, and fields. They compute with numbers alone, and call only what Numba
    compiles without memory of its own.

    ``force(stretch, ...)`` is required. ``update(stretch, ...)`` returns the next history, once a step; it may also ask
    for the time step `dt` and for the stretch `before`, a step ago. ``energy(stretch, ...)`` is stored, so that its
    derivative is the force; half the force times the stretch unless given. ``damage(...)`` is the fraction of the
    stiffness that is lost; a bond with 1 breaks.

    Attributes
    ----------
    history : dict of str to float
        Numbers that a bond remembers, and their values at the start.
    elastic_limit : float or None
        Stretch up to which the bond is a spring and remembers nothing: what is stretched less costs nothing more. None
        if there is none.
    tag : str
        Its `type` in a case file: ``ViscoelasticBond`` is "viscoelastic-bond".
    known : dict of str to type
        All laws by name, including user-defined ones.

    Raises
    ------
    InputError
        When a law is made: a function that Numba does not compile, or that takes memory; a force that is not a number,
        is stiffer than the bond, or is not the derivative of the energy, or differs from the stretch up to
        `elastic_limit`.
    TypeError
        When a class is defined without a force, or with a function that asks for what is not given or reads a
        variable.

    Notes
    -----
    The energy that is lost as the history changes from h to h' is that at h less that at h', both at the present
    stretch and that a step ago, so that velocity Verlet balances energies to rounding where the energy is a square of
    the stretch. As for all bonds that may break, those within one reach of sides that are not free are springs.

    Examples
    --------
    >>> import farhorizon as fh
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Plastic(fh.BondLaw):
    ...     "Bonds that yield at a stretch."
    ...     limit: float
    ...     history = {"slip": 0.0}
    ...     @staticmethod
    ...     def update(stretch, slip, limit):
    ...         return min(max(slip, stretch - limit), stretch + limit)
    ...     @staticmethod
    ...     def force(stretch, slip):
    ...         return stretch - slip
    ...     @staticmethod
    ...     def energy(stretch, slip):
    ...         return (stretch - slip) ** 2 / 2
    >>> metal = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, law=Plastic(0.002))
    """

    tag: ClassVar[str]
    known: ClassVar[dict[str, type[BondLaw]]] = {}
    history: ClassVar[Mapping[str, float]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not isinstance(getattr(cls, "force", None), FunctionType):
            raise TypeError(f"{cls.__name__} needs a static method force(stretch, ...)")
        if cls.history and getattr(cls, "update", None) is None:
            raise TypeError(f"{cls.__name__} has a history, so that it needs a static method update(stretch, ...)")
        for name, function in _functions(cls).items():
            # forces and energies of a history that rests depend on the present stretch alone
            given = [*GIVEN, *(OF_STEP if name == "update" else ()), *cls.history, *_parameters(cls)]
            unknown = [argument for argument in inspect.signature(function).parameters if argument not in given]
            if unknown:
                raise TypeError(
                    f"{cls.__name__}.{name} asks for {', '.join(unknown)}, which is not given; there are "
                    f"{', '.join(given)}: make it a field, or a number in history"
                )
            if variable := _variable(function):
                raise TypeError(
                    f"{cls.__name__}.{name} reads the variable {variable}, which files do not hold: make it a field"
                )

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]  # all laws that can be made are dataclasses
            kinds.set_fields(self, **{field.name: kinds.number(getattr(self, field.name), f"law.{field.name}")})
        self.check()

    @property
    def elastic_limit(self) -> float | None:
        """Stretch up to which the bond is a spring and remembers nothing; None if there is none."""
        return None

    @property
    def functions(self) -> BondFunctions:
        """The functions, compiled."""
        return _compiled(type(self))

    @property
    def breaks(self) -> bool:
        """Whether bonds may break."""
        return self.functions.damage is not None

    @property
    def timed(self) -> bool:
        """Whether forces depend on how fast a bond is stretched: a function takes the time step."""
        return any("dt" in inspect.signature(function).parameters for function in _functions(type(self)).values())

    def numbers(self, dt: float, frozen: bool = False) -> np.ndarray:
        """Parameters for the compiled loop, see `farhorizon.engine.bonds.Bonds.parameters`."""
        return np.array([float(frozen), dt, *self.arguments.values()])

    @property
    def arguments(self) -> dict[str, float]:
        """Values of the fields by name."""
        return {name: float(getattr(self, name)) for name in self.functions.parameters}

    def course(self, stretches: Any, dt: float = 1.0, length: float = 1.0) -> dict[str, np.ndarray]:
        """Return what a single bond does as it is stretched step by step.

        Parameters
        ----------
        stretches : array_like, shape (n,)
            Stretches at successive steps; before the first one the bond is not stretched.
        dt : float
            Time step.
        length : float
            Length of the bond.

        Returns
        -------
        dict of str to ndarray
            Each of shape (n,): "force", "energy" and "damage", in the units of the law, and the numbers of the history.
        """
        functions, history, before = self.functions, dict(self.history), 0.0
        rows = []
        for stretch in np.asarray(stretches, float).ravel().tolist():
            given = {"stretch": stretch, "before": before, "dt": dt, "length": length, **self.arguments}
            if functions.update is not None:
                moved = _called(functions, "update", given | history)
                history = dict(zip(history, moved if isinstance(moved, tuple) else [moved], strict=True))
            force = _called(functions, "force", given | history)
            energy = force * stretch / 2 if functions.energy is None else _called(functions, "energy", given | history)
            damage = 0.0 if functions.damage is None else _called(functions, "damage", given | history)
            rows.append({"force": force, "energy": energy, "damage": damage, **history})
            before = stretch
        return {name: np.array([row[name] for row in rows], float) for name in (rows[0] if rows else ())}

    def check(self, dt: float = 1.0, length: float = 1.0) -> None:
        """Try the law for bonds of a length and a time step; raise the InputError of what cannot be used."""
        up = np.geomspace(_LEAST, _LONGEST, _TRIALS)
        down = np.geomspace(_LEAST, -_SHORTEST, _TRIALS)
        for stretches in (up, -down, np.concatenate([up, up[::-1], -down])):
            for name, values in self.course(stretches, dt, length).items():
                wrong = ~np.isfinite(values)
                if wrong.any():
                    at = f"the stretch {stretches[wrong][0]:.3g} of a bond of length {length:.3g}, dt = {dt:.3g}"
                    raise self._refused(f"{name} is not a number at {at}", values[wrong][0], "finite", "a value there")
        if self.elastic_limit is not None:
            self._check_spring(np.concatenate([-down, up[up <= self.elastic_limit], [self.elastic_limit]]), dt, length)
        for top in (0.0, _LEAST, 1e-4, 1e-2, _LONGEST):
            history = dict(self.history)
            if history and top:
                course = self.course(np.linspace(0.1 * top, top, 10), dt, length)
                history = {name: float(course[name][-1]) for name in history}
            given = {"before": top, "dt": dt, "length": length, **self.arguments, **history}
            self._check_slopes(given, np.concatenate([up, -down])[:: _TRIALS // 20])

    def _check_spring(self, stretches: np.ndarray, dt: float, length: float) -> None:
        """Refuse a law by which bonds are no springs at some stretches, or remember them."""
        course = self.course(stretches, dt, length)
        wrong = np.abs(course["force"] - stretches) > _ROUNDING * np.abs(stretches)
        for name, value in self.history.items():
            wrong |= course[name] != value
        if wrong.any():
            raise self._refused(
                f"bonds up to elastic_limit are springs that remember nothing, but not at {stretches[wrong][0]:.3g}",
                course["force"][wrong][0],
                f"{stretches[wrong][0]:.3g}",
                "force and update accordingly, or elastic_limit = None",
            )

    def _check_slopes(self, given: dict[str, float], stretches: np.ndarray) -> None:
        """Compare forces at neighbouring stretches, and with the slopes of the energy, for a history that rests."""
        functions = self.functions
        at_rest = _called(functions, "force", given | {"stretch": 0.0})
        if functions.energy is None and at_rest != 0:
            raise self._refused(
                "a bond has a force without a stretch, so that the energy does not follow from it",
                f"{at_rest:.3g}",
                "0, or energy(stretch, ...)",
                "define an energy, of which the force is the derivative",
            )
        for less in stretches:
            more = less * (1 + _APART)
            low, high = (_called(functions, "force", given | {"stretch": stretch}) for stretch in (less, more))
            rounding = _ROUNDING * max(abs(low), abs(high), _LEAST) / abs(more - less)
            slope = (high - low) / (more - less)
            if slope > 1 + rounding:
                raise self._refused(
                    f"the force is stiffer than the bond at the stretch {less:.3g}, so that the step may be unstable",
                    f"slope {slope:.4g}",
                    "1",
                    "forces in units of the largest stiffness, and moduli that are those of it",
                )
            if functions.energy is None:
                continue
            first, last = (_called(functions, "energy", given | {"stretch": stretch}) for stretch in (less, more))
            error = abs((last - first) / (more - less) - (low + high) / 2)
            # the trapezoidal rule is exact for squares; for others its error is of second order
            rounding = np.finfo(float).eps / abs(more - less)  # of an energy that is a difference of numbers up to 1
            if error > _APART * max(abs(low), abs(high)) + rounding:
                raise self._refused(
                    f"the force is not the derivative of the energy at the stretch {less:.3g}",
                    f"{low:.6g}",
                    f"{(last - first) / (more - less):.6g}",
                    "an energy of which the force is the derivative while the history rests",
                )

    def _refused(self, what: str, value: Any, limit: str, remedy: str) -> InputError:
        return InputError(f"{type(self).__name__}: {what}", value=value, limit=limit, key="model.law", remedy=remedy)


def _parameters(law: type[BondLaw]) -> list[str]:
    """Names of the fields of a class, also before `dataclass` has made it one."""
    names: dict[str, None] = {}
    for base in reversed(law.__mro__[: law.__mro__.index(BondLaw)]):
        hints = vars(base).get("__annotations__", {})
        names |= {name: None for name, hint in hints.items() if "ClassVar" not in str(hint)}
    return list(names)


def _functions(law: type[BondLaw]) -> dict[str, FunctionType]:
    """The functions of a law by name."""
    return {name: getattr(law, name) for name in _NAMES if getattr(law, name, None) is not None}


def _variable(function: FunctionType) -> str:
    """A variable that a function reads; empty if there is none: functions, modules and names that Numba will miss."""
    if function.__code__.co_freevars:
        return function.__code__.co_freevars[0]
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        callable_ = isinstance(value, (FunctionType, BuiltinFunctionType, type, ModuleType, np.ufunc))
        if value is not None and not (callable_ or hasattr(value, "py_func")):
            return name
    return ""


def _called(functions: BondFunctions, name: str, given: Mapping[str, float]) -> Any:
    """Value of a function for arguments by name."""
    return getattr(functions, name)(*[given[argument] for argument in dict(functions.arguments)[name]])


@cache
def _compiled(law: type[BondLaw]) -> BondFunctions:
    """Compile the functions of a class; InputError if Numba cannot, or if they take memory."""
    import numba  # late: slow to import

    made: dict[str, Any] = dict.fromkeys(_NAMES)
    arguments = []
    for name, function in _functions(law).items():
        names = tuple(inspect.signature(function).parameters)
        arguments.append((name, names))
        made[name] = _without_memory(law, name, function, numba.types.float64, len(names))
        expected = len(law.history) if name == "update" else 1
        result: Any = made[name].nopython_signatures[0].return_type
        numbers = [*result] if _is_tuple(result) else [result]
        if len(numbers) != expected or not all(
            isinstance(kind, numba.types.Number) and kind != numba.types.complex128 for kind in numbers
        ):
            raise InputError(
                f"{law.__name__}.{name} does not return {expected} number{'s' * (expected > 1)}",
                value=str(result),
                limit=", ".join(law.history) if name == "update" else "a number",
                key="model.law",
                remedy="return them in the order of history" if name == "update" else "return a number",
            )
    return BondFunctions(
        **made,
        history=tuple(law.history),
        start=tuple(map(float, law.history.values())),
        parameters=tuple(_parameters(law)),
        arguments=tuple(arguments),
    )


def _is_tuple(result: Any) -> bool:
    import numba

    return isinstance(result, numba.types.BaseTuple)


def _without_memory(law: type[BondLaw], name: str, function: Callable[..., Any], number: Any, count: int) -> Any:
    """A function of numbers, compiled without Numba's memory, in which arrays and lists cannot be made."""
    import numba

    try:
        compiler: Any = numba.njit
        made = compiler([(number,) * count], error_model="numpy", _nrt=False)(function)
        takes, reason = "NRT_" in next(iter(made.inspect_llvm().values())), ""
    except Exception as error:  # whatever it is, the law cannot be used
        reason = str(error)
        takes = any(words in reason for words in _OF_MEMORY)
    if not (takes or reason):
        return made
    lines = [line.strip() for line in reason.splitlines() if line.strip() and not line.startswith("Failed in")]
    raise InputError(
        f"{law.__name__}.{name} takes memory" if takes else f"Numba does not compile {law.__name__}.{name}",
        value="an array, a list or a text" if takes else lines[0] if lines else reason,
        limit="numbers alone",
        key="model.law",
        remedy="scalar arithmetic, math, and functions with numba.njit",
    )


@dataclass(frozen=True)
class _Softening:
    """The numbers of a law that is a spring up to an onset, and softens beyond it."""

    onset: float
    final: float

    def __post_init__(self) -> None:
        kinds.number(self.onset, "law.onset", above=0)
        kinds.number(self.final, "law.final", above=self.onset)
        super().__post_init__()  # type: ignore[misc]  # that of the law

    @property
    def elastic_limit(self) -> float:
        """The onset."""
        return self.onset


@dataclass(frozen=True)
class BilinearSoftening(_Softening, BondLaw):
    """Bonds whose force falls linearly from an onset, to zero at a final stretch, where they break.

    They unload along the secant. Over all bonds across a plane, a crack takes ``onset * final`` times the fracture
    energy of a critical stretch of 1; ``softening = "linear"`` of `Elastic` chooses `final` by the fracture energy.

    Parameters
    ----------
    onset : float
        Stretch at which the force is largest.
    final : float
        Stretch at which nothing is left.

    Raises
    ------
    InputError
        An onset that is not positive, or a final stretch that is not larger.

    Examples
    --------
    >>> import farhorizon as fh
    >>> law = fh.BilinearSoftening(onset=0.01, final=0.04)
    >>> [round(float(force), 6) for force in law.course([0.01, 0.025, 0.0125, 0.05])["force"]]
    [0.01, 0.005, 0.0025, 0.0]
    """

    history: ClassVar[Mapping[str, float]] = {"largest": 0.0}

    @staticmethod
    def update(stretch: float, largest: float, onset: float) -> float:
        """Largest stretch beyond the onset so far."""
        return stretch if stretch > onset and stretch > largest else largest

    @staticmethod
    def force(stretch: float, largest: float, onset: float, final: float) -> float:
        """Stretch times the secant of the curve at the largest stretch."""
        top = max(largest, onset)
        return stretch * (onset * max(final - top, 0.0) / (top * (final - onset)))

    @staticmethod
    def damage(largest: float, onset: float, final: float) -> float:
        """What the secant has lost."""
        top = max(largest, onset)
        return 1 - onset * max(final - top, 0.0) / (top * (final - onset))


@dataclass(frozen=True)
class ExponentialSoftening(_Softening, BondLaw):
    """Bonds whose force decays exponentially beyond an onset.

    They unload along the secant, and never lose all of it. `final` is the stretch at which the bilinear law that takes
    the same energy would end.

    Parameters
    ----------
    onset : float
        Stretch at which the force is largest.
    final : float
        The force falls to ``exp(-2)`` at this stretch.

    Raises
    ------
    InputError
        An onset that is not positive, or a final stretch that is not larger.

    Examples
    --------
    >>> import farhorizon as fh
    >>> law = fh.ExponentialSoftening(onset=0.01, final=0.03)
    >>> float(law.course([0.03])["force"][0] / 0.01).__round__(6)
    0.135335
    """

    history: ClassVar[Mapping[str, float]] = {"largest": 0.0, "secant": 1.0}

    @staticmethod
    def update(stretch: float, largest: float, secant: float, onset: float, final: float) -> tuple[float, float]:
        """Largest stretch beyond the onset so far, and the secant of the curve there."""
        if stretch > onset and stretch > largest:
            return stretch, onset / stretch * math.exp(-2 * (stretch - onset) / (final - onset))
        return largest, secant

    @staticmethod
    def force(stretch: float, secant: float) -> float:
        """Stretch times the secant of the curve at the largest stretch."""
        return stretch * secant

    @staticmethod
    def damage(secant: float) -> float:
        """What the secant has lost."""
        return 1 - secant


@dataclass(frozen=True)
class ViscoelasticBond(BondLaw):
    """Bonds of a standard linear solid: a spring beside a spring and a dashpot in series.

    At a constant stretch the force relaxes to ``1 - relaxing`` of that of the spring, as ``exp(-t / time)``. The moduli
    of the solid are those before relaxation, which fast waves see.

    Parameters
    ----------
    relaxing : float
        Fraction of the stiffness that relaxes, 0 to 1.
    time : float
        Time in which it does.

    Raises
    ------
    InputError
        A fraction outside 0 to 1, or a time that is not positive.

    Notes
    -----
    The stretch q of the dashpot follows ``q' = (s - q) / time`` by the trapezoidal rule, of second order in the time
    step. In a step ``relaxing dt / time`` times the squared mean of ``s - q`` is lost, never less than nothing.
    Absorbing sides continue the solid before relaxation.

    Examples
    --------
    >>> import farhorizon as fh
    >>> law = fh.ViscoelasticBond(relaxing=0.4, time=2.0)
    >>> [round(float(force), 3) for force in law.course([0.01] * 10001, dt=0.001)["force"][[0, 2000, 10000]] / 0.01]
    [1.0, 0.747, 0.603]
    """

    relaxing: float
    time: Duration
    history: ClassVar[Mapping[str, float]] = {"viscous": 0.0}

    def __post_init__(self) -> None:
        kinds.number(self.relaxing, "law.relaxing", least=0, most=1)
        kinds.number(self.time, "law.time", above=0)
        super().__post_init__()

    @staticmethod
    def update(stretch: float, before: float, viscous: float, dt: float, time: float) -> float:
        """Stretch of the dashpot a step later."""
        return viscous + dt * (stretch + before - 2 * viscous) / (2 * time + dt)

    @staticmethod
    def force(stretch: float, viscous: float, relaxing: float) -> float:
        """Force of both springs."""
        return stretch - relaxing * viscous

    @staticmethod
    def energy(stretch: float, viscous: float, relaxing: float) -> float:
        """Energy of both springs."""
        return ((1 - relaxing) * stretch**2 + relaxing * (stretch - viscous) ** 2) / 2
