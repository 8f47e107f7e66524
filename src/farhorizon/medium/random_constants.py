"""Material constants that vary randomly from place to place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, Length, Unit
from farhorizon.files.storable import Storable

_BESIDE = 1e-6  # shift of the cell edges, in cells, so that nodes half a cell from a middle do not lie on one


@dataclass(frozen=True)
class Weibull(Storable):
    """A random constant, with a different value in each cell of a grid, ``P(value > s) = exp(-(s/scale)^modulus)``.

    It is a function of position alone: the same on every lattice, for any order of nodes and any number of threads, and
    on finer lattices, where a cell contains more nodes. With cells of one spacing each node has its own value.

    Parameters
    ----------
    scale : float
        The value that a fraction 1/e, 37 %, exceeds.
    modulus : float
        Weibull modulus m: the larger it is, the smaller the scatter (standard deviation about 1.2/m of the mean).
    cell : float
        Edge length of the cells, for example the grain size; the origin lies in the middle of a cell.
    seed : int
        A different seed gives a different sample.

    Raises
    ------
    InputError
        A scale, modulus or cell that is not positive.

    Notes
    -----
    Weibull (1951), Journal of Applied Mechanics 18. A bond breaks when its weaker end would, so that the strength of a
    body lies below `scale`, the more so the more cells it contains. The numbers are those of the generator of Steele,
    Lea and Flood (2014), OOPSLA, applied to the numbers of the cell and the seed.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> strength = fh.Weibull(scale=0.01, modulus=8, cell=0.5)
    >>> stone = fh.Elastic(fh.Kernel(1.5, 1), young=50.0, critical_stretch=strength)
    >>> bool(strength(0.0, 0.1) == strength(0.2, -0.1)), bool(strength(0.0, 0.1) == strength(1.0, 0.1))
    (True, False)
    >>> x = 0.5 * np.arange(100_000)
    >>> round(float((strength(x, 0.0) > 0.01).mean()), 2)
    0.37
    """

    tag: ClassVar[str] = "weibull"
    scale: Annotated[float, Unit(ANY)]
    modulus: float
    cell: Length
    seed: int = 0

    def __post_init__(self) -> None:
        positive = {name: kinds.number(getattr(self, name), name, above=0) for name in ("scale", "modulus", "cell")}
        kinds.set_fields(self, **positive, seed=kinds.integer(self.seed, "seed", least=0))

    def __call__(self, *at: Any) -> Any:
        """The values at coordinates, of their common shape."""
        cells = [np.floor(np.asarray(x, float) / self.cell + 0.5 + _BESIDE) for x in np.broadcast_arrays(*at)]
        return self.scale * (-np.log(uniform(self.seed, *cells))) ** (1 / self.modulus)


def uniform(seed: int, *numbers: np.ndarray) -> np.ndarray:
    """Uniform random numbers strictly between 0 and 1, determined by a seed and arrays of whole numbers of one
    shape.
    """
    bits = _mixed(np.asarray(seed, np.uint64))
    for values in numbers:
        bits = _mixed(bits ^ np.asarray(values).astype(np.int64).view(np.uint64))
    return np.asarray(((bits >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53)


def _mixed(bits: np.ndarray) -> np.ndarray:
    """One step of SplitMix64."""
    with np.errstate(over="ignore"):  # arithmetic modulo 2^64
        bits = bits + np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(bits ^ (bits >> np.uint64(31)))
