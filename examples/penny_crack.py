"""A block with a penny-shaped crack that opens while heat passes.

Physics: a block |x|, |y| < 1, |z| < 0.8 between a cold lower and a hot upper face, insulated at its sides, in its
steady state of constant flux. At t = 0.1 a crack of radius 0.5 opens in the middle plane; a tenth of the bonds'
conductivity is left, or none. Heat goes round it: the power falls, and the faces of the crack part in temperature.

Prints the power through the middle plane before and after, the heat balance, and the jump at the centre beside ``4
radius gradient / pi``, that of an insulating penny in an infinite body (the harmonic function of an elliptic disc);
here the sides of the block and the horizon change it by some per cent.

Run: ``python examples/penny_crack.py``; about 10 seconds.
"""

import numpy as np

import farhorizon as fh

SPACING, HORIZON, RADIUS, OPENS = 0.05, 0.1, 0.5, 0.1


def block(factor: float, opens: float = OPENS) -> fh.Simulation:
    """The block with a crack that conducts `factor` of what the body does; nodes beyond |z| = 0.8 hold the mirror
    conditions.
    """
    kernel = fh.Kernel(HORIZON)
    beyond = SPACING * fh.Heat(kernel).stencil(SPACING, 3).reach[2]
    edge = np.array([1.0, 1.0, 0.8 + beyond]) - SPACING / 2
    lattice = fh.Lattice(SPACING, -edge, edge)
    walls = [fh.Temperature("z-", 0.0, "mirror"), fh.Temperature("z+", 1.6, "mirror")]
    crack = fh.Crack(fh.DiscCut((0, 0, 0), (0, 0, 1), RADIUS), factor, opens)
    model = fh.Heat(kernel, integrator=fh.RungeKuttaChebyshev(10))
    return fh.Simulation(
        lattice, model, fh.Free(), {"u": lambda x, y, z: z + 0.8}, cracks=[crack], constraints=walls, balance=True
    )


def middle(sim: fh.Simulation) -> tuple[float, float]:
    """Power down through the middle plane, and the jump across it at the centre, the constant gradient over a spacing
    taken off.
    """
    above, below = (
        sim.fields["u"][sim.lattice.index((SPACING / 2, SPACING / 2, side * SPACING / 2))] for side in (1, -1)
    )
    return -sim.power_across("z", 0.0), above - below - SPACING


def main() -> None:
    """Before the crack opens, and long after: one that conducts a little, and an insulating one."""
    for factor in (0.1, 0.0):
        sim = block(factor)
        sim.run(OPENS, progress=False)
        before, _ = middle(sim)
        sim.run(2.0, progress=False)
        after, jump = middle(sim)
        balance = sim.balance()
        print(f"factor {factor}: power through the middle {before:.4f} before the crack opens, {after:.4f} after")
        print(f"  jump at the centre {jump:.4f}; insulating and in an infinite body {4 * RADIUS / np.pi:.4f}")
        print(f"  heat balance: residual {balance['residual']:.1e} of {abs(balance['constraint[1]']):.3g} that came in")


if __name__ == "__main__":
    main()
