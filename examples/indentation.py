"""A brittle half-space under a sudden pressure between two notches: cracks, and where the work of the load goes.

Physics: linear correspondence elasticity in plane strain, bonds that break for good beyond a critical stretch, waves
that leave through layers on three sides. Scaling: spacing, Young's modulus and density are 1, so a longitudinal wave
crosses a spacing in about one time unit. The set-up is that of Wildman and Gazonas (2012), section 3B (`farhorizon
reproduce wildman2012-fig7` has their units), with a load that rises smoothly.

Run: ``python examples/indentation.py``. Takes some ten seconds.
"""

import numpy as np

import farhorizon as fh

UNTIL = 90.0
KERNEL = fh.Kernel(horizon=3.717, exponent=0, influence="gaussian", width=1.0, volume="full")


def half_space(pressure: float, rise: float = 10.0) -> fh.Body:
    """81 x 41 nodes below a free surface, pressed down between the notches."""
    lattice = fh.Lattice(spacing=1.0, lower=(-40, -40), upper=(40, 0))
    load = fh.Traction("y+", (0.0, -pressure), between=[(-10, 10)], time=lambda t: min(t / rise, 1.0))
    notches = [[(x, 1.0), (x, -1.1)] for x in (-10.5, 10.5)]
    return fh.Body(
        lattice,
        KERNEL,
        young=1.0,
        poisson=0.2,
        boundary={"all": fh.NonlocalPML(30), "y+": fh.Free()},
        loads=[load],
        cracks=notches,
        critical_stretch=0.003,
        drag=0.9,
        balance=True,
    )


def share(body: fh.Body) -> dict[str, float]:
    """Energies over the work of the load."""
    found = body.energies()
    work = found.pop("work")
    return {name: value / work for name, value in found.items()}


def main() -> None:
    """Two pressures: the notches hold, or cracks start from them."""
    for pressure in (0.002, 0.006):
        body = half_space(pressure)
        for note in body.notes:
            print(note)
        body.run(UNTIL)
        shares = share(body)
        print(
            f"pressure {pressure:g}: {body.broken_bonds} bonds broken, {int((body.damage() > 0.15).sum())} nodes with "
            "more than 15 % of them lost"
        )
        print(
            "   of the work: "
            + ", ".join(f"{name} {100 * value:.1f} %" for name, value in shares.items())
            + f"; residual {1 - np.sum(list(shares.values())):.0e}"
        )


if __name__ == "__main__":
    main()
