"""Arithmetic expressions of x, y, z and t, as written in case files.

A case file is data: the text is parsed by `ast`, checked against a list of what is allowed, and evaluated by walking
the tree. Nothing is compiled or run as Python. Every number is a double, so that a tower of powers overflows to
infinity at once instead of growing an integer.
"""

from __future__ import annotations

import ast
import difflib
import functools
import inspect
import operator
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from farhorizon import kinds
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable

__all__ = ["CONSTANTS", "FUNCTIONS", "MAX_LENGTH", "MAX_NESTING", "Expression", "as_given", "as_signal", "function"]

MAX_LENGTH = 10_000
"""Longest text of an expression, in characters."""
MAX_NESTING = 100
"""Largest depth of nesting, to which each further term of a sum or a product adds one level; the walk stays far from
Python's recursion limit.
"""

COORDINATES = ("x", "y", "z")
CONSTANTS: dict[str, np.float64] = {"pi": np.float64(np.pi), "e": np.float64(np.e)}
"""Named constants."""


def _minimum(*values: Any) -> Any:
    return functools.reduce(np.minimum, values)


def _maximum(*values: Any) -> Any:
    return functools.reduce(np.maximum, values)


def _where(condition: Any, then: Any, otherwise: Any) -> Any:
    return np.where(condition != 0, then, otherwise)


def _heaviside(x: Any) -> Any:
    return np.heaviside(x, 1.0)


FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int | None]] = {
    "exp": (np.exp, 1, 1),
    "log": (np.log, 1, 1),
    "sqrt": (np.sqrt, 1, 1),
    "sin": (np.sin, 1, 1),
    "cos": (np.cos, 1, 1),
    "tan": (np.tan, 1, 1),
    "sinh": (np.sinh, 1, 1),
    "cosh": (np.cosh, 1, 1),
    "tanh": (np.tanh, 1, 1),
    "asin": (np.arcsin, 1, 1),
    "acos": (np.arccos, 1, 1),
    "atan": (np.arctan, 1, 1),
    "atan2": (np.arctan2, 2, 2),
    "abs": (np.abs, 1, 1),
    "sign": (np.sign, 1, 1),
    "floor": (np.floor, 1, 1),
    "min": (_minimum, 2, None),
    "max": (_maximum, 2, None),
    "where": (_where, 3, 3),
    "heaviside": (_heaviside, 1, 1),
    "erf": (erf, 1, 1),
}
"""Functions by name: the callable, and its least and greatest number of arguments (None: no limit)."""


class _OfNumbers:
    """A function of numbers that acts on arrays: compiled at its first call if Numba can, otherwise called for each
    entry.
    """

    def __init__(self, given: Callable[..., float]) -> None:
        self.__wrapped__ = given
        self.compiled: bool | None = None
        self._of_arrays: Callable[..., Any] = given

    def __call__(self, *arrays: Any) -> NDArray[np.float64]:
        arrays = tuple(np.asarray(array, float) for array in arrays)
        if self.compiled is None:
            self.compiled = self._compile(*arrays)
        try:
            return np.asarray(self._of_arrays(*arrays), float)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            raise InputError(
                f"the function {self.__wrapped__.__name__} has failed",
                value=f"{type(error).__name__}: {error}",
                limit="a real number for all arguments with which it is called",
                remedy="a value, or nan, where it is not defined",
            ) from None

    def _compile(self, *arrays: NDArray[np.float64]) -> bool:
        """Compile, and return whether Numba can: whether it compiles and calculates what Python does."""
        import numba  # late: slow to import

        some = [array.flat[: 1 if array.size else 0] for array in arrays]
        self._of_arrays = np.vectorize(self.__wrapped__, otypes=[float])
        try:
            made = numba.vectorize([numba.float64(*[numba.float64] * len(arrays))])(self.__wrapped__)
            alike = np.allclose(made(*some), self._of_arrays(*some), rtol=1e-12, atol=0, equal_nan=True)
        except Exception:  # whatever it is, the function may still be called as it was written
            return False
        if alike:
            self._of_arrays = made
        return bool(alike)


OWN: dict[str, _OfNumbers] = {}
"""Functions of users, by name."""


def function(given: Callable[..., float]) -> Callable[..., float]:
    """Give a function of your own to expressions, under its name.

    Texts may then call it, as in ``"burning(u, x)"``, wherever expressions are accepted: for sources and conductivities
    that depend on the field, initial values, signals. Case files and checkpoints name it; a program that reads them
    imports the module that defines it first.

    Parameters
    ----------
    given : callable
        A function of one or more numbers, by position, that returns a number; it may contain branches and loops. It is
        compiled by Numba at its first use if Numba can, otherwise called for each node.

    Returns
    -------
    callable
        The function itself, so that this can be used as a decorator.

    Raises
    ------
    InputError
        Not a function; arguments of varying number, or that must be named; a name that expressions have already,
        unless it is that of the same function, defined again.

    Examples
    --------
    >>> import farhorizon as fh
    >>> @fh.function
    ... def burning(u, rate):
    ...     "What is hotter than 0.3 burns."
    ...     return rate * (1 - u) if u > 0.3 else 0.0
    >>> line = fh.Lattice(0.1, -3, 3)
    >>> spread = fh.Diffusion(fh.Kernel(0.3))
    >>> sim = fh.Simulation(line, spread, fh.Free(), {"u": "exp(-x**2)"}, sources=["burning(u, 5)"])
    >>> sim.step(10)
    """
    name = getattr(given, "__name__", "")
    if isinstance(given, type) or not callable(given) or not name.isidentifier():
        raise InputError(
            "must be a function with a name",
            value=shown(given),
            limit="a function that def defines",
            key="function",
            remedy="def name(u, x): return ...",
        )
    arguments = list(inspect.signature(given).parameters.values())
    if not arguments or any(a.kind is not a.POSITIONAL_OR_KEYWORD or a.default is not a.empty for a in arguments):
        raise InputError(
            "must be a function of numbers that are given by position",
            value=f"{name}{inspect.signature(given)}",
            limit="one argument or more, without defaults",
            key="function",
            remedy=f"def {name}(u, x): return ...",
        )
    taken = name in OWN and _place(OWN[name].__wrapped__) != _place(given)
    if taken or (name in FUNCTIONS and name not in OWN) or name in (*CONSTANTS, *COORDINATES, "t", "u"):
        raise InputError(
            "expressions have this name already",
            value=name,
            limit=", ".join([*FUNCTIONS, *CONSTANTS, *COORDINATES, "t", "u"]),
            key="function",
            remedy="another name",
        )
    OWN[name] = _OfNumbers(given)
    FUNCTIONS[name] = OWN[name], len(arguments), len(arguments)
    return given


def _place(given: Callable[..., Any]) -> tuple[str, str]:
    """Return the module of a function, and its name there."""
    return given.__module__, given.__qualname__


_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.Mod: operator.mod,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}

# What users write out of habit: its name in words, and what to write instead.
_FORBIDDEN: dict[type[ast.AST], tuple[str, str]] = {
    ast.BitXor: ("the operator ^", "write a power as **"),
    ast.FloorDiv: ("the operator //", "write floor(a/b)"),
    ast.BitAnd: ("the operator &", "multiply the conditions"),
    ast.BitOr: ("the operator |", "write max(a, b)"),
    ast.MatMult: ("the operator @", "use + - * / ** %"),
    ast.LShift: ("the operator <<", "use + - * / ** %"),
    ast.RShift: ("the operator >>", "use + - * / ** %"),
    ast.And: ("'and'", "multiply the conditions"),
    ast.Or: ("'or'", "write max(a, b)"),
    ast.Not: ("'not'", "write 1 - condition"),
    ast.Invert: ("the operator ~", "write 1 - condition"),
    ast.In: ("'in'", "use < <= > >= == !="),
    ast.NotIn: ("'not in'", "use < <= > >= == !="),
    ast.Is: ("'is'", "use =="),
    ast.IsNot: ("'is not'", "use !="),
    ast.IfExp: ("'if ... else'", "write where(condition, a, b)"),
    ast.Attribute: ("an attribute (a dot after a name)", "use the plain names, e.g. exp(x)"),
    ast.Subscript: ("a subscript [...]", "use x, y, z and t"),
    ast.Lambda: ("a lambda", "write the formula itself"),
    ast.NamedExpr: ("an assignment (:=)", "write the formula itself"),
    ast.Tuple: ("a tuple (a comma outside a function)", "write one formula; a decimal number takes a point"),
    ast.List: ("a list", "write one formula"),
    ast.JoinedStr: ("a formatted string", "write one formula"),
}


class Expression(Storable):
    """An arithmetic expression of the coordinates and the time.

    Operators ``+ - * / ** %`` with Python's precedence, comparisons ``< <= > >= == !=`` (also chained), which give 0 or
    1, the constants ``pi`` and ``e`` and the functions in `FUNCTIONS`; ``log`` is the natural logarithm,
    ``heaviside(x)`` is 1 for x >= 0 and 0 below, ``where(c, a, b)`` is a where c is not zero and b elsewhere, ``min``
    and ``max`` act elementwise.

    Parameters
    ----------
    text : str
        The expression; line breaks count as spaces.
    dim : int, optional
        Number of coordinates, 0 to 3: the names allowed are the first `dim` of x, y, z, and t. Unless given, it is
        determined by the context in which the expression is used, for example by the lattice; see `on`.

    Attributes
    ----------
    text : str
        The expression as given.
    dim : int or None
        Number of coordinates.
    uses_time, uses_space : bool
        Whether t, or any coordinate, occurs.

    Raises
    ------
    InputError
        For a syntax error (with its position), an unknown name or function (with the nearest known one and the complete
        list), any construct that is not arithmetic, a wrong number of arguments, a number outside the range of double
        precision, and a text that is too long or too deeply nested.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> fh.Expression("exp(-x**2) * (t < 1)", dim=1)(np.array([0.0, 1.0]), t=0.5)
    array([1.        , 0.36787944])
    """

    text: str
    dim: int | None
    uses_time: bool
    uses_space: bool
    _tree: ast.expr

    def __init__(self, text: str, dim: int | None = None) -> None:
        dim = None if dim is None else kinds.integer(dim, "expression.dim", least=0, most=len(COORDINATES))
        self._set(text, _checked(text, (*COORDINATES[:dim], "t")), dim)

    def on(self, dim: int) -> Expression:
        """The expression for the given number of coordinates: the expression itself or, if it was created without a
        number of coordinates or for fewer, a new one parsed from its text.

        Raises
        ------
        InputError
            A coordinate that does not exist.
        """
        return self if self.dim == dim else Expression(self.text, dim)

    def _set(self, text: str, tree: ast.expr, dim: int | None) -> None:
        names = _names(tree)
        self.text, self.dim, self._tree = text, dim, tree
        self.uses_time = "t" in names
        self.uses_space = not names.isdisjoint(COORDINATES)

    def __repr__(self) -> str:
        return f"Expression({self.text!r})" if self.dim is None else f"Expression({self.text!r}, dim={self.dim})"

    def __call__(self, *coordinates: ArrayLike, t: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Evaluate the expression.

        Parameters
        ----------
        *coordinates : array_like
            The `dim` coordinates, of shapes that broadcast. An expression of t alone, ``dim=0``, may also be called
            with t.
        t : array_like, optional
            The time.

        Returns
        -------
        ndarray of float64
            A new array of the common shape of all coordinates and t, also of those that the expression does not use. An
            undefined operation gives nan or inf, without a warning: the part that `where` discards may be undefined.

        Raises
        ------
        InputError
            If the number of coordinates is not `dim`, or the shapes do not broadcast.
        """
        if self.dim is None:
            return self.on(min(len(coordinates), len(COORDINATES)))(*coordinates, t=t)
        if self.dim == 0 and len(coordinates) == 1:
            return self(t=coordinates[0])
        if len(coordinates) != self.dim:
            raise InputError(f"{self!r} takes {self.dim} coordinates", value=len(coordinates))
        arrays = [kinds.array(c, "expression", finite=False) for c in (*coordinates, t)]
        try:
            shape = np.broadcast_shapes(*(a.shape for a in arrays))
        except ValueError:
            raise InputError(
                "the shapes of the coordinates and t do not broadcast", value=[a.shape for a in arrays]
            ) from None
        values: dict[str, Any] = {**CONSTANTS, **dict(zip((*COORDINATES[: self.dim], "t"), arrays, strict=True))}
        result = np.empty(shape)
        with np.errstate(all="ignore"):
            result[...] = _evaluate(self._tree, values)
        return result

    def separate(self) -> tuple[Expression, Expression] | None:
        """Split into a factor of space times a factor of time.

        Only products, quotients and signs are considered: ``exp(-x**2)*sin(t)`` splits, ``exp(x + t)`` does not.

        Returns
        -------
        space, time : Expression
            ``space(*coordinates) * time(t=t)`` equals the expression, to rounding error. `time` has ``dim=0``: it takes
            no coordinates and gives one number for one t. Constant factors belong to `space`. An expression without t
            has the time factor 1, one without coordinates a constant `space`.
        None
            If the expression does not split.
        """
        space, time = _Product(), _Product()
        for node, inverse in _factors(self._tree):
            names = _names(node)
            if "t" not in names:
                space.append(node, inverse)
            elif names.isdisjoint(COORDINATES):
                time.append(node, inverse)
            else:
                return None
        return space.expression(self.dim), time.expression(0)


def function_of(text: str, names: Sequence[str], key: str) -> Callable[..., NDArray[np.float64]]:
    """Return an expression as a function of arrays with these names; raises InputError for a text that is not one of
    them.
    """
    try:
        tree = _checked(text, tuple(names))
    except InputError as error:
        raise error.at(key) from None

    def evaluated(*arrays: ArrayLike) -> NDArray[np.float64]:
        values: dict[str, Any] = {**CONSTANTS, **dict(zip(names, map(np.asarray, arrays), strict=True))}
        with np.errstate(all="ignore"):
            found = _evaluate(tree, values)
        return np.array(np.broadcast_to(found, np.broadcast_shapes(*map(np.shape, arrays))), float)

    return evaluated


def as_given(value: Any, dim: int, key: str, *, time: bool = True) -> Any:
    """Return what a user gives for a function of space and time, or a list with one entry per component, with texts as
    `Expression` of the lattice's coordinates. Raises InputError for a text that is not one, or depends on t where no
    `time` may occur, a function of other arguments, and values that are not real numbers.
    """
    if isinstance(value, list | tuple) and not all(isinstance(part, Real) for part in value):
        entries = [as_given(part, dim, f"{key}[{i}]", time=time) for i, part in enumerate(value)]
        return entries if any(new is not old for new, old in zip(entries, value, strict=True)) else value
    if not isinstance(value, str | Expression):
        if not callable(value):
            kinds.array(value, key, finite=False)
        elif not time:
            kinds.function(value, key, ", ".join(COORDINATES[:dim]))
        return value
    try:
        if isinstance(value, str) and not time:
            _checked(value, COORDINATES[:dim])
        expression = value.on(dim) if isinstance(value, Expression) else Expression(value, dim)
    except InputError as error:
        raise error.at(key) from None
    if expression.uses_time and not time:
        raise InputError(
            "cannot depend on t", value=expression.text, key=key, remedy=f"use {', '.join(COORDINATES[:dim])}"
        )
    return expression


def as_signal(value: Any, key: str) -> Any:
    """Return what a user gives for a function of t alone, a text, an expression or a number as an `Expression`, a
    callable as it is; raises InputError for anything else.
    """
    if isinstance(value, str | Expression):
        try:
            return value.on(0) if isinstance(value, Expression) else Expression(value, 0)
        except InputError as error:
            raise error.at(key) from None
    if isinstance(value, Real) and not isinstance(value, bool):
        return Expression(repr(kinds.number(value, key)), 0)
    return kinds.function(value, key, "t")


class _Product:
    """A product under construction: its tree and its text."""

    def __init__(self) -> None:
        self.tree: ast.expr = ast.Constant(1.0)
        self.text = ""

    def append(self, node: ast.expr, inverse: bool) -> None:
        text = ast.unparse(node)
        if not isinstance(node, (ast.Name, ast.Call)):
            text = f"({text})"
        if not self.text and not inverse:
            self.tree, self.text = node, text
        else:
            self.tree = ast.BinOp(self.tree, ast.Div() if inverse else ast.Mult(), node)
            self.text = f"{self.text or '1'}{'/' if inverse else '*'}{text}"

    def expression(self, dim: int | None) -> Expression:
        # Bypasses the constructor: its limits apply to what users write, and the reordered product may be a little
        # longer than that.
        result = Expression.__new__(Expression)
        result._set(self.text or "1", self.tree, dim)
        return result


def _factors(node: ast.expr, inverse: bool = False) -> Iterable[tuple[ast.expr, bool]]:
    """Yield the factors of a product, each with whether it divides."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Mult, ast.Div)):
        yield from _factors(node.left, inverse)
        yield from _factors(node.right, inverse != isinstance(node.op, ast.Div))
    elif isinstance(node, ast.UnaryOp):
        if isinstance(node.op, ast.USub):
            yield ast.Constant(-1.0), False
        yield from _factors(node.operand, inverse)
    else:
        yield node, inverse


def _names(tree: ast.expr) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def _parse(text: str) -> ast.expr:
    if not isinstance(text, str):
        raise InputError("an expression is a text", value=shown(text), remedy="put it in quotes")
    if len(text) > MAX_LENGTH:
        raise InputError("the expression is too long", value=f"{len(text)} characters", limit=MAX_LENGTH)
    if "#" in text:
        # Python would take the rest for a comment and silently drop it.
        raise InputError("an expression cannot contain a comment (#)", value=text)
    # One line without indentation; each line break or tab becomes one space, so that positions are kept.
    line = text.translate(dict.fromkeys(map(ord, "\r\n\t\f"), " ")).rstrip()
    try:
        tree = ast.parse(line.lstrip(), mode="eval").body
    except SyntaxError as error:
        position = len(line) - len(line.lstrip()) + (error.offset or 1)
        raise InputError(f"syntax error at character {position}: {error.msg}", value=text) from None
    except ValueError as error:
        raise InputError(f"not an expression: {error}", value=text) from None
    except (RecursionError, MemoryError):
        raise _too_deep() from None
    level: list[ast.AST] = [tree]
    for _ in range(MAX_NESTING):
        level = [child for node in level for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
    if level:
        raise _too_deep()
    return tree


def _too_deep() -> InputError:
    limit = f"{MAX_NESTING} levels"
    return InputError(
        "the expression is too deeply nested", limit=limit, remedy="bracket the terms of a long sum in groups"
    )


def _checked(text: str, variables: Sequence[str]) -> ast.expr:
    """The tree of an expression of given variables; raises InputError for anything else."""
    tree = _parse(text)
    try:
        _check(tree, variables)
    except InputError as error:
        raise (
            error
            if error.value is not None
            else InputError(error.message, value=text, limit=error.limit, remedy=error.remedy)
        ) from None
    return tree


def _check(node: ast.expr, variables: Sequence[str]) -> None:
    """Raise an InputError unless the tree contains only what `_evaluate` knows."""
    match node:
        case ast.Constant(value=value):
            _check_number(value)
        case ast.Name(id=name):
            _check_name(name, variables)
        case ast.UnaryOp(op=op, operand=operand):
            _check_operators([op], _UNARY)
            _check(operand, variables)
        case ast.BinOp(left=left, op=op, right=right):
            _check_operators([op], _BINARY)
            _check(left, variables)
            _check(right, variables)
        case ast.Compare(left=left, ops=ops, comparators=comparators):
            _check_operators(ops, _COMPARE)
            for part in (left, *comparators):
                _check(part, variables)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            _check_call(name, len(args), variables)
            for part in args:
                _check(part, variables)
        case ast.Call(func=ast.Name()):
            raise InputError(
                "named arguments are not allowed in an expression", remedy="give the arguments in their order"
            )
        case ast.Call(func=ast.Attribute() as function):
            raise _forbidden(function)
        case ast.Call():
            raise InputError("only a function name can stand before a bracket", remedy="write a product as a*(b)")
        case ast.BoolOp(op=op):
            raise _forbidden(op)
        case _:
            raise _forbidden(node)


def _forbidden(node: ast.AST) -> InputError:
    words, remedy = _FORBIDDEN.get(type(node), (f"the construct {type(node).__name__}", "use arithmetic only"))
    return InputError(f"{words} is not allowed in an expression", remedy=remedy)


def _check_operators(ops: Iterable[ast.AST], known: Mapping[Any, Any]) -> None:
    for op in ops:
        if type(op) not in known:
            raise _forbidden(op)


def _check_number(value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        given_type = "a string" if isinstance(value, str) else f"a constant of type {type(value).__name__}"
        raise InputError(f"{given_type} is not allowed in an expression", value=repr(value), remedy="use real numbers")
    # Python compares a huge integer exactly, where a conversion to float raises.
    if value > sys.float_info.max:
        raise InputError("a number in the expression is beyond the double range", limit=sys.float_info.max)


def _check_name(name: str, variables: Sequence[str]) -> None:
    known = [*variables, *CONSTANTS]
    if name in known:
        return
    if name == "t":
        raise InputError("cannot depend on t", remedy=f"use {', '.join(variables)}")
    if name in COORDINATES:
        dim = sum(variable in COORDINATES for variable in variables)
        where = f"in {dim} dimensions" if dim else "in a function of t alone"
        raise InputError(f"there is no {name} {where}", remedy=f"use {', '.join(variables)}")
    if name in FUNCTIONS:
        raise InputError(f"the function {name} needs its arguments in brackets", remedy=f"write {name}(...)")
    raise InputError(f"unknown name {name!r} in the expression", remedy=_suggest(name, known))


def _check_call(name: str, count: int, variables: Sequence[str]) -> None:
    if name not in FUNCTIONS:
        if name in (*variables, *CONSTANTS):
            raise InputError(f"{name} is not a function", remedy=f"write a product as {name}*(...)")
        remedy = f"{_suggest(name, list(FUNCTIONS))}; a function of your own: import what gives it to fh.function"
        raise InputError(f"unknown function {name!r} in the expression", remedy=remedy)
    _, least, most = FUNCTIONS[name]
    if count < least or (most is not None and count > most):
        raise InputError(
            f"wrong number of arguments of {name}", value=count, limit=least if most == least else f"at least {least}"
        )


def _suggest(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
    return (f"did you mean {near[0]}? " if near else "") + f"known: {', '.join(known)}"


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            # A numpy scalar: its powers overflow to inf and give nan where Python's raise or turn complex.
            return np.float64(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=op, operand=operand):
            return _UNARY[type(op)](_evaluate(operand, values))
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](_evaluate(left, values), _evaluate(right, values))
        case ast.Compare(left=left, ops=ops, comparators=comparators):
            return _compare(ops, [_evaluate(part, values) for part in (left, *comparators)])
        case ast.Call(func=ast.Name(id=name), args=args):
            return FUNCTIONS[name][0](*[_evaluate(part, values) for part in args])
    raise AssertionError(f"unchecked node {type(node).__name__}")


def _compare(ops: list[ast.cmpop], parts: list[Any]) -> Any:
    result: Any = np.float64(1.0)
    for op, left, right in zip(ops, parts, parts[1:], strict=False):
        result = result * _COMPARE[type(op)](left, right)
    return result
