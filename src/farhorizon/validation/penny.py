r"""Heat flow around an insulating penny-shaped crack in an infinite body.

Far away the temperature has the gradient g along the normal of the crack. The disturbance is the field of a disc of
radius a whose faces emit and absorb the heat that would cross it. Its steady state is a harmonic function with the
elliptic jump between the faces

.. math:: [T](r) = \frac{4g}{\pi}\sqrt{a^2 - r^2}

(Carslaw and Jaeger, 1959, Conduction of heat in solids; Sneddon, 1946, for the same potential in mode I). It is reached
by diffusion of the disturbance into the body, of which only the neighbourhood of the crack is computed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from farhorizon import Crack, Diffusion, DiscCut, Lattice, LatticePML, RungeKuttaChebyshev, Simulation, Source, Stencil
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

HEAT = "Sneddon (1946), The distribution of stress in the neighbourhood of a crack in an elastic solid"
RADIUS = 0.5
UNTIL = 4.0  # 16 radius^2 / diffusivity
SPACINGS = (0.1, 0.05)


def steady(r: np.ndarray, radius: float) -> np.ndarray:
    """Exact steady jump of the temperature at the distances r from the middle, for a unit gradient."""
    return 4 / np.pi * np.sqrt(np.maximum(radius**2 - r**2, 0.0))


def jump(spacing: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Distances from the middle of the nodes beside the crack, final jump across it, and radius of a disc with the area
    of the cut in the lattice.
    """
    lattice = Lattice(spacing, (-0.8, -0.8, spacing / 2 - 0.5), (0.8, 0.8, 0.5 - spacing / 2))
    x, y, z = lattice.coordinates()
    r = np.hypot(x, y)
    given = np.sign(z) * ((r < RADIUS) & (np.abs(z) < spacing)) / spacing
    sim = Simulation(
        lattice,
        Diffusion(Stencil.finite_difference(3), integrator=RungeKuttaChebyshev(10)),
        LatticePML(target=1e-3, until=UNTIL),
        sources=[Source(given)],
        cracks=[Crack(DiscCut((0, 0, 0), (0, 0, 1), RADIUS), 0.0)],
    ).run(UNTIL, progress=False)
    middle = lattice.shape[2] // 2
    u = sim.fields["u"]
    # the faces lie half a spacing beyond the nodes, and the unit gradient is added between
    cut = spacing * np.sqrt((r[:, :, 0] < RADIUS).sum() / np.pi)
    return r[:, :, 0], u[:, :, middle] - u[:, :, middle - 1] + spacing, float(cut)


def draw_profile(
    r: np.ndarray,
    computed: np.ndarray,
    radius: float,
    exact: Callable[[np.ndarray, float], np.ndarray],
    what: str,
    picture: Path,
) -> None:
    """Draw computed and exact values at the distances r from the middle of a disc, over the exact value there."""
    from farhorizon.pictures.curves import curve_panels

    places, first = np.unique(np.round(r, 9), return_index=True)
    smooth, middle = radius * np.sin(np.linspace(0.0, np.pi / 2, 100)), exact(np.zeros(1), radius)
    curves = [
        ("exact", smooth / radius, exact(smooth, radius) / middle),
        ("computed", places / radius, computed[first] / middle),
    ]
    curve_panels([("", curves)], picture, xlabel="r / a", ylabel=f"{what} / exact largest")


@validation("penny-crack", HEAT, "heat that flows around an insulating penny-shaped crack")
def penny(folder: Path) -> Outcome:
    """The jump in the middle and along the radius."""
    ratios = []
    for spacing in SPACINGS:
        r, opened, radius = jump(spacing)
        ratios.append(float(opened[np.unravel_index(r.argmin(), r.shape)] / (4 * radius / np.pi)))
    rows = [
        Row(f"jump in the middle over 4 a g / pi, spacing a/{RADIUS / spacing:g}", ratio, 1.0)
        for spacing, ratio in zip(SPACINGS, ratios, strict=True)
    ]
    order = np.log2((ratios[0] - 1) / (ratios[1] - 1))
    rows.append(Row("order in the spacing", float(order), 1.0, note="the rim is a staircase"))
    inside, picture = r < RADIUS, folder / "penny-crack.png"
    draw_profile(r[inside], opened[inside], radius, steady, "jump", picture)
    return Outcome(rows, pictures=[picture])
