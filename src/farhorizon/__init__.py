"""farhorizon: peridynamic and classical waves, elasticity, diffusion, heat and corrosion in an unbounded medium, on a
small grid.
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:  # so that type checkers see all names, and report unknown ones
    from farhorizon.case.case import read_case as read_case
    from farhorizon.public import *
else:

    def __getattr__(name: str) -> Any:
        """Load names on first use: importing NumPy, SciPy and the rest takes a second, in which the command line must
        be interruptible.
        """
        from difflib import get_close_matches
        from importlib import import_module
        from importlib.util import find_spec

        if name == "__all__":
            return _public_names()
        if name.startswith("_"):
            raise AttributeError(f"module 'farhorizon' has no attribute {name!r}")
        if find_spec(f"farhorizon.{name}"):
            return import_module(f"farhorizon.{name}")
        if name == "read_case":  # the module for case files imports every public name
            return import_module("farhorizon.case.case").read_case
        public = vars(import_module("farhorizon.public"))
        if name not in public:
            near = get_close_matches(name, _public_names(), 1)
            guess = f"; did you mean {near[0]!r}?" if near else ""
            raise AttributeError(f"module 'farhorizon' has no attribute {name!r}{guess}")
        return public[name]


def _public_names() -> list[str]:
    """Names in `farhorizon.public`, and `read_case`."""
    from farhorizon import public

    return sorted(["read_case", *(name for name in vars(public) if not name.startswith("_"))])


def __dir__() -> list[str]:
    return [*_public_names(), "__version__"]
