"""Numbers with units in case files, and the units in which a case gives its numbers."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from farhorizon.arguments import ANY, FIELD, RATE
from farhorizon.errors import InputError

#: Base quantities for which a case may give units, with their SI units; the powers of a `Unit` are in this order.
BASES = {"mass": "kg", "length": "m", "time": "s", "temperature": "K", "amount": "mol"}
#: Quantities that may be given in place of the mass, which follows from any of them with length and time.
MASS_BY = {"force": "N", "pressure": "Pa", "density": "kg/m^3", "energy": "J"}

_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
QUANTITY = _NUMBER.pattern + r"(\s*(?![eE][-+]?\d)(?!(?:if|and|or)\b)[A-Za-z\u00b5\u03bc\u00b0]|\s+1\s*/).*"
"""Regular expression of a number with a unit; no arithmetic expression matches it."""
_QUOTIENT = re.compile(rf"(?P<number>{_NUMBER.pattern})\s*/\s*(?P<below>.+)")
_SUPERSCRIPTS = str.maketrans("\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079", "-0123456789")


@dataclass(frozen=True)
class Unit:
    """A unit as a multiple of a product of powers of the SI units in `BASES`; a temperature has a zero, in kelvins."""

    scale: float
    powers: tuple[int, ...]
    zero: float = 0.0

    def __mul__(self, other: Unit) -> Unit:
        return Unit(self.scale * other.scale, tuple(a + b for a, b in zip(self.powers, other.powers, strict=True)))

    def __pow__(self, power: int) -> Unit:
        return Unit(self.scale**power, tuple(power * a for a in self.powers))


_ONE = Unit(1.0, (0, 0, 0, 0, 0))
_PREFIXES = {
    "n": 1e-9,
    "u": 1e-6,
    "\u03bc": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "": 1.0,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
    "T": 1e12,
}
# Units that take prefixes, and units that do not: scale, and powers of kg, m, s, K, mol.
_PREFIXED = {
    "g": (1e-3, (1, 0, 0, 0, 0)),
    "m": (1.0, (0, 1, 0, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0)),
    "K": (1.0, (0, 0, 0, 1, 0)),
    "mol": (1.0, (0, 0, 0, 0, 1)),
    "Hz": (1.0, (0, 0, -1, 0, 0)),
    "N": (1.0, (1, 1, -2, 0, 0)),
    "Pa": (1.0, (1, -1, -2, 0, 0)),
    "J": (1.0, (1, 2, -2, 0, 0)),
    "W": (1.0, (1, 2, -3, 0, 0)),
}
_PLAIN = {
    "min": (60.0, (0, 0, 1, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0)),
    "d": (86400.0, (0, 0, 1, 0, 0)),
    "day": (86400.0, (0, 0, 1, 0, 0)),
    "year": (365.25 * 86400.0, (0, 0, 1, 0, 0)),
    "t": (1e3, (1, 0, 0, 0, 0)),
    "l": (1e-3, (0, 3, 0, 0, 0)),
    "bar": (1e5, (1, -1, -2, 0, 0)),
}
_SYMBOLS = {
    prefix + symbol: Unit(factor * scale, powers)
    for symbol, (scale, powers) in _PREFIXED.items()
    for prefix, factor in _PREFIXES.items()
}
_SYMBOLS |= {symbol: Unit(*given) for symbol, given in _PLAIN.items()}
_SYMBOLS["degC"] = Unit(1.0, _SYMBOLS["K"].powers, zero=273.15)


def unit(text: str) -> Unit:
    """The unit that a string such as "W/(m K)", "1/us" or "kg m^-3" denotes; InputError if it denotes none."""
    written = text.strip().replace("^", "**").replace("\u00b0", "deg").replace("\u00b7", "*")
    superscript = f"[{''.join(map(chr, _SUPERSCRIPTS))}]+"
    written = re.sub(superscript, lambda power: f"**{power[0].translate(_SUPERSCRIPTS)}", written)
    try:
        return _value(ast.parse(re.sub(r"(?<=[\w)])\s+(?=[\w(])", "*", written), mode="eval").body)
    except (SyntaxError, ValueError, ArithmeticError, RecursionError, MemoryError):
        raise InputError(
            "unknown unit",
            value=text,
            limit=f"products and powers of {', '.join((*_PREFIXED, *_PLAIN, 'degC'))}; prefixes n, u, m, c, k, M, G, T",
            remedy='for example "mm", "kg/m^3", "W/(m K)", "1/s", "s^-1"; in expressions products are written with *',
        ) from None


def _known_unit(text: str, key: str) -> Unit:
    """The unit that the string at a key denotes; an InputError names the key."""
    try:
        return unit(text)
    except InputError as error:
        raise error.at(key) from None


def _value(node: ast.expr) -> Unit:
    match node:
        case ast.Name(name) if name in _SYMBOLS:
            return _SYMBOLS[name]
        case ast.Constant(1):
            return _ONE
        case ast.BinOp(left, ast.Mult(), right):
            return _value(left) * _value(right)
        case ast.BinOp(left, ast.Div(), right):
            return _value(left) * _value(right) ** -1
        case ast.BinOp(left, ast.Pow(), ast.Constant(int(power))) if power < 10:
            return _value(left) ** power
        case ast.BinOp(left, ast.Pow(), ast.UnaryOp(ast.USub(), ast.Constant(int(power)))) if power < 10:
            return _value(left) ** -power
    raise ValueError


class Units:
    """The units of the table ``[units]``: of quantities in `BASES`, and possibly one of `MASS_BY` in place of the mass;
    `field` is the SI unit of u, or `ANY`. InputError for a unit that is unknown, measures something else, or determines
    the mass again.
    """

    def __init__(self, given: Mapping[str, str], field: str = ANY) -> None:
        self._named = {FIELD: field, RATE: ANY if field == ANY else f"{field}/s"}
        self._bases: dict[str, tuple[str, Unit]] = {}
        for name, text in given.items():
            try:
                given_unit, usual = unit(text), {**BASES, **MASS_BY}[name]
            except InputError as error:
                raise error.at(f"units.{name}") from None
            if given_unit.powers != unit(usual).powers:
                raise InputError(f"is not a unit of {name}", value=text, limit=f"such as {usual}", key=f"units.{name}")
            base = "mass" if name in MASS_BY else name
            if base in self._bases:
                masses = [quantity for quantity in given if quantity == "mass" or quantity in MASS_BY]
                raise InputError("the unit of mass follows from one of them", value=", ".join(masses), key="units")
            self._bases[base] = text, given_unit

    def number(self, value: float, text: str, si: str, key: str) -> float:
        """A number with a unit, converted to the units of the case; InputError for a unit that is unknown, that
        measures something else than the key takes, or something for which the case has no unit.
        """
        given_unit = _known_unit(text, key)
        given, expected = f"{value:g} {text}", self._named.get(si, si)
        if expected != ANY and given_unit.powers != unit(expected).powers:
            raise InputError("the unit measures something else", value=given, limit=f"such as {expected}", key=key)
        scale, exponents = 1.0, self._exponents(given_unit.powers)
        for base, power in exponents.items():
            if base not in self._bases:
                raise InputError(
                    f"the case has no unit of {base}",
                    value=given,
                    key=key,
                    remedy=f'{base} = "{BASES[base]}" in [units]',
                )
            scale *= self._bases[base][1].scale ** power
        zero = given_unit.zero - self._bases["temperature"][1].zero if exponents == {"temperature": 1} else 0.0
        return float(f"{(value * given_unit.scale + zero) / scale:.15g}")  # without rounding errors of the conversion

    def name(self, si: str) -> str:
        """The unit of the case for what an SI unit measures, as text; empty if the case has none."""
        si = self._named.get(si, si)
        exponents = self._exponents(unit(si).powers) if si != ANY else {}
        if not exponents or not exponents.keys() <= self._bases.keys():
            return ""
        above = [_power(self._bases[base][0], power) for base, power in exponents.items() if power > 0]
        below = [_power(self._bases[base][0], -power) for base, power in exponents.items() if power < 0]
        over = " ".join(below) if len(below) < 2 else f"({' '.join(below)})"
        return " ".join(above or ["1"]) + (f"/{over}" if over else "")

    def _exponents(self, powers: tuple[int, ...]) -> dict[str, int]:
        """Exponents of the units of the case in a unit with the given powers of SI units."""
        # the quantity that determines the mass contains it in the first power, and also length and time
        mass = self._bases["mass"][1].powers if "mass" in self._bases else _SYMBOLS["kg"].powers
        rest = [powers[0], *(a - powers[0] * b for a, b in zip(powers[1:], mass[1:], strict=True))]
        return {base: power for base, power in zip(BASES, rest, strict=True) if power}


def _power(text: str, power: int) -> str:
    if power == 1:
        return text
    inner = text if re.fullmatch(r"[\w\u00b0]+", text) else f"({text})"
    return inner + {2: "\u00b2", 3: "\u00b3"}.get(power, f"^{power}")


def plain(value: Any, si: str | None, units: Units | None, key: str) -> Any:
    """The value of a key, which measures an SI unit, with plain numbers in place of those with units; InputError for a
    number with a unit in a case that has no ``[units]``, for a number over a unit, and as in `Units.number`.
    """
    if isinstance(value, list):
        return [plain(entry, si, units, f"{key}[{i}]") for i, entry in enumerate(value)]
    if si is None or not isinstance(value, str):
        return value
    if not re.fullmatch(QUANTITY, value):
        _check_quotient(value, key)
        return value
    digits = _NUMBER.match(value)
    assert digits
    text = value[digits.end() :].strip()
    if units is None:
        _known_unit(text, key)
        raise InputError(
            "a number with a unit needs a case that states its own units",
            value=f"the text {value!r}",
            key=key,
            remedy='[units] with length = "m", time = "s", mass = "kg"',
        )
    return units.number(float(digits[0]), text, si, key)


def _check_quotient(text: str, key: str) -> None:
    """Refuse a number over a unit, as in "2/K": it would be read as an expression, in which K is unknown."""
    divided = _QUOTIENT.fullmatch(text)
    if divided is None or re.search(r"\bt\b", text):  # in expressions t is the time, not the tonne
        return
    inverse = f"1/{divided['below']}"
    try:
        unit(inverse)
    except InputError:
        return
    raise InputError(
        "a number over a unit reads as an expression, and expressions have no units",
        value=f"the text {text!r}",
        key=key,
        remedy=f'"{divided["number"]} {inverse}", with a space',
    )
