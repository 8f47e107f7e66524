"""The experiment of Kalthoff and Winkler: a projectile strikes a steel plate between two notches (SI units).

Physics: the projectile, as heavy as the steel cylinder of the experiment and rigid, hits the edge at 32 m/s. The waves
load the notches in shear, and cracks run from their tips at nearly 70 degrees to the notch, driven by what returns from
the sides of the plate: where it goes on without end on three sides, they stop after a centimetre.

Prints for both plates how far and at which angle the cracks run, and what the projectile loses beside the work that it
does on the plate.

Run: ``python examples/struck_plate.py``; about ten seconds.
"""

import numpy as np

import farhorizon as fh

MM, US = 1e-3, 1e-6
PLATE = fh.Lattice(MM, (-49.5 * MM, -99.5 * MM), (49.5 * MM, 99.5 * MM))
STEEL = fh.Elastic(fh.Kernel(3 * MM, exponent=1), young=191e9, density=8000.0, fracture_energy=42408.0)
NOTCHES = [[(-60 * MM, y), (0.0, y)] for y in (-25 * MM, 25 * MM)]
MASS, SPEED = 8000.0 * 0.05 * 0.1, 32.0  # of a cylinder of 50 mm and 100 mm length, per metre of thickness
PROJECTILE = fh.Impactor(fh.Box((-150 * MM, -24.9 * MM), (-49.5 * MM, 24.9 * MM)), MASS, (SPEED, 0.0))
SIDES = {"finite": fh.Free(), "unbounded": {"all": fh.LatticePML(nodes=20), "x-": fh.Free()}}


def struck(name: str, until: float = 90 * US) -> tuple[fh.Simulation, fh.Impacts]:
    """Run a plate, finite or unbounded; return it and the record of the projectile."""
    motion, tips = fh.Impacts(), fh.CrackTips(every=10)
    sim = fh.Simulation(
        PLATE, STEEL, SIDES[name], cracks=NOTCHES, loads=[PROJECTILE], observe=[motion, tips], balance=True
    )
    return sim.run(until, progress=False), motion


def grown(sim: fh.Simulation) -> tuple[float, float]:
    """Mean length of the cracks that run from the notches, and their mean angle to these in degrees."""
    tips = sim.recorders[1].data["position"][-1]
    tips = tips[~np.isnan(tips[:, 0])]
    ahead = np.column_stack([tips[:, 0], np.abs(tips[:, 1]) - 25 * MM])
    return np.linalg.norm(ahead, axis=1).mean(), np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])).mean()


def main() -> None:
    """Run both plates and print what becomes of cracks and projectile."""
    for name in SIDES:
        sim, motion = struck(name)
        (length, angle), last = grown(sim), motion.data["velocity"][-1, 0, 0]
        lost = MASS / 2 * (SPEED**2 - last**2)
        print(f"{name}: cracks of {length / MM:.0f} mm at {angle:.0f} degrees, the projectile moves at {last:.1f} m/s")
        print(f"   it has lost {lost:.0f} J/m, and done {sim.energies()['work']:.0f} J/m of work on the plate")


if __name__ == "__main__":
    main()
