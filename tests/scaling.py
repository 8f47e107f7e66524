"""Case files converted to other units of length, time and mass: every key has a dimension."""

import json
import re
import tomllib

from farhorizon.case.units import ANY, Units

LENGTHS = (
    "lower",
    "upper",
    "spacing",
    "radius",
    "centre",
    "points",
    "height",
    "horizon",
    "width",
    "probes",
    "between",
    "corner",
    "edge1",
    "edge2",
    "wavelengths",
)
VARIABLES = r"\b[xyzt]\b"
_MODELS = {  # constants by model: powers of length, time, mass; including the defaults that have a unit
    "wave": {"speed": (1, -1, 0)},
    "beam": {"stiffness": (4, -2, 0)},
    "diffusion": {"diffusivity": (2, -1, 0)},
    "corrosion": {"diffusivity": (2, -1, 0)},
    "heat": {"density": (-3, 0, 1), "specific_heat": (2, -2, 0), "conductivity": (1, -3, 1)},
    "elastic": {"density": (-3, 0, 1)},
    "correspondence": {"density": (-3, 0, 1)},
}
_MODULUS, _RATE = (-1, -2, 1), (0, -1, 0)
_SOLID = {"young": _MODULUS, "bulk": _MODULUS, "shear": _MODULUS, "density": (-3, 0, 1), "fracture_energy": (0, -2, 1)}
_TIMES = ("until", "dt", "every", "pictures", "opens", "duration", "probe_every")
_RATES = ("damping", "drag", "strength", "shift", "sigma", "alpha", "frequencies")


def in_units(text: str, length: float, time: float, mass: float) -> str:
    """Return a case file in other units, of which the old ones are these multiples, with all its numbers and
    expressions, so that the problem stays the same.

    Displacements of solids are lengths; scalar fields have no unit.
    """
    case = numbers(tomllib.loads(text))
    units = (length, time, mass)
    model = case["model"]
    solid = model["type"] in ("elastic", "correspondence")
    for name in _MODELS[model["type"]]:
        model.setdefault(name, 1.0)
    field = (1, 0, 0) if solid else (0, 0, 0)
    force = (
        (-2, -2, 1)
        if solid
        else (-1, -3, 1)
        if model["type"] == "heat"
        else (0, -2, 0)
        if model["type"] in ("wave", "beam")
        else _RATE
    )

    def size(dimension: tuple[int, int, int]) -> float:
        found = 1.0
        for unit, power in zip(units, dimension, strict=True):
            found *= unit**power
        return found

    def dimension(path: tuple[str, ...]) -> tuple[int, int, int] | None:
        """Return the dimension of a key, None for pure numbers and words."""
        key, room = path[-1], path[0]
        if key in ("without", "text", "file", "font", "bold", "type", "direction", "polarisation", "side"):
            return None
        if room == "initial":
            return field if key == "u" else tuple(a - b for a, b in zip(field, (0, 1, 0), strict=True))
        if room == "source" and key == "value":
            return force
        if room == "load" and key == "value":
            return force if "body-force" in path else _MODULUS
        if (room == "constraint" and key == "value") or (room == "incident" and key == "signal"):
            return field
        if room in ("model", "material") and key in _SOLID and solid:
            return _SOLID[key]
        if room == "model" and key in _MODELS[model["type"]]:
            return _MODELS[model["type"]][key]
        if key in LENGTHS or (key in ("start", "end") and "line" in path):
            return (1, 0, 0)
        if key == "every" and room != "output":
            return None  # a number of steps
        return (
            (0, 1, 0)
            if key in _TIMES
            else _RATE
            if key in _RATES
            else (0, 0, 0)
            if key in ("coefficient", "time")
            else None
        )

    def variable(found: re.Match) -> str:
        return f"({found[0]}/{time if found[0] == 't' else length!r})"

    def scaled(value, path):
        if isinstance(value, dict):
            kind = [value["type"]] if "type" in value else []
            return {key: scaled(inner, (*path, *kind, key)) for key, inner in value.items()}
        if isinstance(value, list):
            return [scaled(inner, path) for inner in value]
        unit = dimension(path)
        if unit is None or isinstance(value, bool):
            return value
        if isinstance(value, str):
            return f"{size(unit)!r}*({re.sub(VARIABLES, variable, value)})"
        return value * size(unit)

    return toml({key: scaled(value, (key,)) for key, value in case.items()})


def numbers(case: dict) -> dict:
    """Return a case with plain numbers, in its own units, in place of values with a unit, and without the table of
    units.
    """
    units = Units(case.get("units", {}))

    def plain(value):
        if isinstance(value, dict):
            return {key: plain(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [plain(inner) for inner in value]
        measured = re.fullmatch(r"([-+.\deE]+) ([^\W\d].*)", value) if isinstance(value, str) else None
        return units.number(float(measured[1]), measured[2], ANY, "") if measured else value

    return {key: plain(value) for key, value in case.items() if key != "units"}


def toml(case: dict) -> str:
    """Return plain data as TOML, with each table on one line."""

    def shown(value) -> str:
        if isinstance(value, dict):
            return "{ " + ", ".join(f"{json.dumps(key)} = {shown(inner)}" for key, inner in value.items()) + " }"
        if isinstance(value, list):
            return "[" + ", ".join(shown(inner) for inner in value) + "]"
        return json.dumps(value) if isinstance(value, bool | str) else repr(value)

    return "\n".join(f"{key} = {shown(value)}" for key, value in case.items()) + "\n"
