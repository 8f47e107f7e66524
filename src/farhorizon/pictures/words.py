"""Names of quantities at axes and colour bars: words and symbols for their names in files."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from farhorizon.pictures.style import with_unit

_NONE: Mapping[str, str] = MappingProxyType({})


class Name(NamedTuple):
    """Name of a quantity."""

    words: str
    symbol: str = ""  # in TeX; empty if words suffice


_NAMES = {
    "u": Name("", "u"),
    "v": Name("velocity", "v"),
    "T": Name("temperature", "T"),
    "damage": Name("damage"),
    "solid": Name("metal"),
    "dissolved": Name("time of dissolution"),
    "thermal_strain": Name("thermal strain"),
    "stress": Name("stress", r"\sigma"),
    "stress_von_mises": Name("von Mises stress"),
    "strain": Name("strain", r"\varepsilon"),
    "gradient": Name("gradient", r"(\nabla u)"),
    **{f"div {field}": Name("divergence", rf"\nabla \cdot {field}") for field in "uv"},
    **{f"curl {field}": Name("curl", rf"\nabla \times {field}") for field in "uv"},
    "pressure": Name("pressure", "p"),
    "divergence": Name("divergence", r"\nabla \cdot u"),
    "curl": Name("curl", r"(\nabla \times u)"),
    "rotation": Name("rotation", r"\omega"),
    "energy_flux": Name("energy flux", "S"),
    "position": Name("position"),
    "advance": Name("advance"),
    "speed": Name("speed"),
    "power": Name("power"),
    "force": Name("force", "F"),
    "displacement": Name("displacement", r"\bar{u}"),
    "young": Name("Young's modulus", "E"),
    "bulk": Name("bulk modulus", "K"),
    "shear": Name("shear modulus", r"\mu"),
    "poisson": Name("Poisson's ratio", r"\nu"),
    "density": Name("density", r"\rho"),
    "coefficient": Name("factor on bonds"),
    "energy": Name("energy"),
    "K_I": Name("stress intensity", r"K_{\mathrm{I}}"),
    "K_II": Name("stress intensity", r"K_{\mathrm{II}}"),
    "K_III": Name("stress intensity", r"K_{\mathrm{III}}"),
    "G": Name("energy release rate", "G"),
}


def in_words(name: str, words: Mapping[str, str] = _NONE) -> str:
    """Name of a quantity, a component ("u_x"), a length ("|u|"), a divergence ("div u") or a curl in words with its
    symbol; unknown names remain, with spaces for underscores. `words` are names of quantities in the case.
    """
    bare = name.strip("|")
    quantity, component = (bare, "") if bare in _NAMES else (bare.rpartition("_")[0], bare.rpartition("_")[2])
    if quantity not in _NAMES:
        return name.replace("_", " ")
    known = _NAMES[quantity]
    symbol = f"{known.symbol}_{{{component}}}" if component else known.symbol
    if not known.symbol:
        return f"{known.words} ${component}$" if component else words.get(quantity, known.words)
    symbol = f"|{symbol}|" if name != bare else symbol
    return f"{words.get(quantity, known.words)} ${symbol}$".strip()


def axis_label(name: str, measured: str, words: Mapping[str, str] = _NONE) -> str:
    """Name of a quantity in words, with the unit of `measured`."""
    return with_unit(in_words(name, words), measured)
