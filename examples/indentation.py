"""A brittle half-space under a sudden pressure between two notches: cracks, and the energy balance.

Physics: linear correspondence elasticity in plane strain, with bonds that break permanently beyond a critical stretch,
and waves that leave through layers on three sides. Scaling: spacing, Young's modulus and density are 1, so a
longitudinal wave crosses a spacing in about one time unit. The set-up is that of Wildman and Gazonas (2012), section 3B
(`farhorizon reproduce wildman2012-fig7` uses their units), with a load that rises gradually.

Run: ``python examples/indentation.py``. Takes about ten seconds.
"""

import farhorizon as fh

UNTIL = 90.0
KERNEL = fh.Kernel(horizon=3.717, exponent=0, influence="gaussian", width=1.0, volume="full")


def half_space(pressure: float, rise: float = 10.0) -> fh.Simulation:
    """81 x 41 nodes below a free surface, pressed down between the notches."""
    lattice = fh.Lattice(spacing=1.0, lower=(-40, -40), upper=(40, 0))
    solid = fh.Correspondence(KERNEL, young=1.0, poisson=0.2, critical_stretch=0.003, drag=0.9)
    load = fh.Traction("y+", (0.0, -pressure), between=[(-10, 10)], time=lambda t: min(t / rise, 1.0))
    notches = [[(x, 1.0), (x, -1.1)] for x in (-10.5, 10.5)]
    sides = {"all": fh.NonlocalPML(30, cross=0.1), "y+": fh.Free()}
    return fh.Simulation(lattice, solid, sides, loads=[load], cracks=notches, balance=True)


def share(sim: fh.Simulation) -> dict[str, float]:
    """Energies divided by the work of the load; "lost" is the energy that left through the layers."""
    found = sim.balance()
    work = found.pop("work")
    return {name: value / work for name, value in found.items()}


def main() -> None:
    """Apply two pressures: under the smaller one the notches hold, under the larger one cracks start from them."""
    for pressure in (0.002, 0.006):
        sim = half_space(pressure)
        for note in sim.notes:
            print(note)
        sim.run(UNTIL)
        damaged = int((sim.fields["damage"] > 0.15).sum())
        print(
            f"pressure {pressure:g}: {sim.broken_bonds} bonds broken, {damaged} nodes with more than 15 % of them lost"
        )
        print("   of the work: " + ", ".join(f"{name} {100 * value:.1f} %" for name, value in share(sim).items()))


if __name__ == "__main__":
    main()
