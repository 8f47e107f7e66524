"""A double couple in full space, with its four lobes of P waves and of S waves.

Physics: slip on a vertical fault in unbounded rock, a strike-slip earthquake. On a horizontal circle around it, the
radial displacement is proportional to ``sin(2 phi)`` and that along the circle to ``cos(2 phi)``: four lobes each, with
those of S waves between those of P waves. Finite elements, which have no horizon, in a cube of 49^3 nodes with
absorbing layers; neither the source nor the receivers lie on nodes.

Prints the largest displacements on the circle next to those of Aki and Richards (2002), eq 4.29. Units: the density and
the speed of S waves are 1, that of P waves is sqrt(3).

Run: ``python examples/double_couple.py``; about half a minute.
"""

import numpy as np

import farhorizon as fh
from farhorizon.analysis.references.full_space import FullSpace

AT, RADIUS, UNTIL = np.array([0.1, -0.05, 0.08]), 4.0, 12.0
RISE = 5.0  # duration of the slip
ANGLES = np.radians(np.arange(0.0, 360.0, 5.0))
OUT = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)
ALONG = np.stack([-np.sin(ANGLES), np.cos(ANGLES), 0 * ANGLES], axis=1)
FAULT = fh.MomentTensor(AT, 1.0, fh.Step(RISE), strike=0.0, dip=90.0, rake=0.0)  # M_xy = 1


def quake(spacing: float = 0.25, until: float = UNTIL) -> tuple[fh.Simulation, fh.Receivers]:
    """Run the simulation; return it and the receivers on the circle."""
    rock = fh.Elastic(None, shear=1.0, poisson=0.25, density=1.0, material="finite-element")
    circle = fh.Receivers(AT + RADIUS * OUT)
    sim = fh.Simulation(
        fh.Lattice(spacing, (-6.0,) * 3, (6.0,) * 3),
        rock,
        boundary=fh.LatticePML(target=1e-3, until=until),
        sources=[FAULT],
        observe=[circle],
    )
    return sim.run(until, progress=False), circle


def lobes(displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest radial displacement at each angle, and largest one along the circle, with their signs, from histories of
    shape (rows, angles, 3).
    """
    parts = [np.einsum("tni,ni->tn", displacement, way) for way in (OUT, ALONG)]
    peak, shear = (np.take_along_axis(part, np.abs(part).argmax(0)[None], 0)[0] for part in parts)
    return peak, shear


def exact(times: np.ndarray) -> np.ndarray:
    """Displacement on the circle according to Aki and Richards, shape (rows, angles, 3)."""
    medium = FullSpace(p_speed=np.sqrt(3.0), s_speed=1.0, density=1.0)
    moment = FAULT.tensor(3)
    courses = [medium.of_moment(RADIUS * way, times, moment, fh.Step(RISE), scale=RISE) for way in OUT]
    return np.moveaxis(courses, 2, 0)


def errors(circle: fh.Receivers) -> tuple[float, float]:
    """Largest differences from the exact lobes of P and of S waves, relative to the largest value of each."""
    pairs = zip(lobes(circle.data["u"]), lobes(exact(circle.times)), strict=True)
    p, s = (float(np.abs(np.abs(ours) - np.abs(known)).max() / np.abs(known).max()) for ours, known in pairs)
    return p, s


def main() -> tuple[fh.Simulation, fh.Receivers]:
    sim, circle = quake()
    print(sim.check())
    ours, known = lobes(circle.data["u"]), lobes(exact(circle.times))
    print("angle     radial      exact  along the circle, exact")
    for n in range(0, 19, 3):
        values = "  ".join(f"{one[n]:+9.5f}" for one in (ours[0], known[0], ours[1], known[1]))
        print(f"{np.degrees(ANGLES[n]):5.0f}  {values}")
    p, s = errors(circle)
    print(f"largest differences: radial {100 * p:.1f} %, along the circle {100 * s:.1f} %")
    return sim, circle


if __name__ == "__main__":
    main()
