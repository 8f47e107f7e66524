"""A penny-shaped crack across a heat flow in the ground.

Physics: far away the temperature always rises by 1 per unit of height. At t = 0 a crack of radius 0.5 opens across this
flow; its bonds retain a tenth of their conductivity, or nothing. Heat flows around it, and a jump of the temperature
between the faces develops. Only the disturbance of the temperature by the crack is computed. It vanishes far away, so
that a block of 1.6 x 1.6 x 1 with absorbing layers on all sides represents the infinite body. The heat that the cut
bonds would carry is released on one face and absorbed on the other.

Prints, up to the steady state, the jump of this disturbance between the nodes beside the crack, at its centre, and the
integral of the jump over the crack. Next to them are ``4 radius / pi`` and ``8 radius^3 / 3``, those between the faces
of an insulating penny-shaped crack in an infinite body (the harmonic function of an elliptic disc). They differ because
of the horizon, which is a fifth of the radius, and because the nodes lie half a spacing from the faces.

Run: ``python examples/penny_crack.py``; about 10 seconds.
"""

import numpy as np

import farhorizon as fh

SPACING, HORIZON, RADIUS = 0.05, 0.1, 0.5
TIMES = (0.02, 0.1, 0.5)  # in radius^2 / diffusivity: 0.08, 0.4, 2


def ground(factor: float) -> fh.Simulation:
    """The disturbance by a crack whose bonds have `factor` times the conductivity of the ground."""
    lattice = fh.Lattice(SPACING, (-0.775, -0.775, -0.475), (0.775, 0.775, 0.475))
    model = fh.Heat(fh.Kernel(HORIZON), integrator=fh.RungeKuttaChebyshev(10))
    disc = fh.DiscCut((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), RADIUS)
    here, stencil = np.stack(lattice.coordinates(), axis=-1), model.stencil(SPACING, 3)
    heat = np.zeros(lattice.shape)
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        heat -= (1 - factor) * disc.cuts(here, here + SPACING * offset) * weight * offset[2] / SPACING
    sides = fh.LatticePML(target=1e-3)
    return fh.Simulation(lattice, model, sides, sources=[heat], cracks=[fh.Crack(disc, factor)])


def jumps(sim: fh.Simulation) -> tuple[float, float]:
    """Jump of the disturbance across the crack at the centre, and its integral over the crack, between the two layers
    of nodes beside it.
    """
    x, y, _ = sim.lattice.coordinates()
    half = sim.lattice.shape[2] // 2
    jump = sim.fields["u"][..., half] - sim.fields["u"][..., half - 1]
    centre = jump[tuple(n // 2 for n in jump.shape)]
    beside = np.hypot(x, y)[..., half] < RADIUS
    return float(centre), float(SPACING**2 * jump[beside].sum())


def main() -> None:
    """Follow a crack that conducts a little, and an insulating one, up to the steady state."""
    print(f"exact, insulating: jump {4 * RADIUS / np.pi:.4f}, integral {8 * RADIUS**3 / 3:.4f}")
    for factor in (0.1, 0.0):
        sim = ground(factor)
        print(f"factor {factor}:")
        for time in (*TIMES, "static"):
            sim.run(time, progress=False, **({"tolerance": 0.01, "limit": 10.0} if time == "static" else {}))
            print("  t = {:.3g}: jump {:.4f}, integral {:.4f}".format(sim.time, *jumps(sim)))


if __name__ == "__main__":
    main()
