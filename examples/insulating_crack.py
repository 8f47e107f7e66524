"""A plate with an insulating crack, compared with refined finite elements.

Physics: steady state of the square |x|, |y| < 1, kept at -1 on the left and +1 on the right, insulated at the top and
bottom, with an insulating crack on x = 0, |y| < 0.4. At the tips the classical flux is singular like 1/sqrt(r).

The temperature is odd in x and even in y, so that the finite elements (scikit-fem, quadratic triangles, refined towards
the tip) need only a quarter: 0 on x = 0 beyond the crack, no condition on the crack, 1 on x = 1. The peridynamic plate
contains the whole crack: bonds across it are cut.

Prints, for decreasing horizons with three nodes in each, the largest difference at two horizons and more from the tips,
relative to 1. It occurs on the faces of the crack, as near to a tip as is compared. There it varies like the
temperature of the singularity, as the square root of the horizon, and is below 1 % for the smallest. At a fixed
distance from the tips it is proportional to the horizon.

Run: ``python examples/insulating_crack.py``; about half a minute; needs scikit-fem.
"""

import numpy as np

import farhorizon as fh

HALF_CRACK = 0.4
TIPS = np.array([[0.0, -HALF_CRACK], [0.0, HALF_CRACK]])
RATIO = 3


def finite_elements(x: np.ndarray, y: np.ndarray, levels: int = 12) -> np.ndarray:
    """Temperature at points (flat arrays), with elements at the tip halved `levels` times."""
    from skfem import Basis, ElementTriP2, MeshTri, condense, solve
    from skfem.models.poisson import laplace

    mesh = MeshTri.init_tensor(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    tip = np.array([0.0, HALF_CRACK])
    for level in range(levels):
        centres = mesh.p[:, mesh.t].mean(axis=1)
        near = np.linalg.norm(centres - tip[:, None], axis=0) < 0.25 * 0.6**level
        mesh = mesh.refined(np.flatnonzero(near))
    basis = Basis(mesh, ElementTriP2())
    cold = basis.get_dofs(lambda p: (p[0] < 1e-12) & (p[1] > HALF_CRACK - 1e-12)).all()
    hot = basis.get_dofs(lambda p: p[0] > 1 - 1e-12).all()
    u = basis.zeros()
    u[hot] = 1.0
    u = solve(*condense(laplace.assemble(basis), x=u, D=np.unique(np.concatenate([cold, hot]))))
    return np.sign(x) * (basis.probes(np.array([np.abs(x), np.abs(y)])) @ u)


def plate(horizon: float) -> fh.Simulation:
    """The peridynamic plate in its steady state; nodes are cell centres, and the mirror conditions have layers beyond
    |x| = 1.
    """
    spacing = horizon / RATIO
    kernel = fh.Kernel(horizon, influence="linear")
    beyond = fh.Heat(kernel).stencil(spacing, 2).reach[0]
    edge = 1 - spacing / 2
    lattice = fh.Lattice(spacing, (-edge - beyond * spacing, -edge), (edge + beyond * spacing, edge))
    walls = [fh.Temperature("x-", -1.0, "mirror"), fh.Temperature("x+", 1.0, "mirror")]
    crack = [(0.0, -HALF_CRACK), (0.0, HALF_CRACK)]
    rate = fh.Heat(kernel).stencil(spacing, 2).symbol_maximum / spacing**2
    model = fh.Heat(kernel, integrator=fh.RungeKuttaChebyshev.for_step(0.02, rate))
    sim = fh.Simulation(
        lattice, model, fh.Free(), {"u": lambda x, y: np.clip(x, -1, 1)}, cracks=[crack], constraints=walls, dt=0.02
    )
    return sim.run(5.0, progress=False)  # the slowest odd mode has decayed by exp(-2.4 * 5)


def differences(horizon: float) -> tuple[float, float]:
    """Largest difference from the finite elements at more than two horizons from the tips, and at more than 0.3."""
    sim = plate(horizon)
    x, y = sim.lattice.coordinates()
    distance = np.min([np.hypot(x - tip[0], y - tip[1]) for tip in TIPS], axis=0)
    away = (distance > 2 * horizon) & (np.abs(x) < 1)
    error = np.abs(sim.fields["u"][away] - finite_elements(x[away], y[away]))
    return float(error.max()), float(error[distance[away] > 0.3].max())


def main() -> None:
    """Compare three horizons."""
    for horizon in (0.06, 0.03, 0.015):
        near, far = differences(horizon)
        print(
            f"horizon {horizon}: {100 * near:.2f} % two horizons from the tips, {100 * far:.2f} % a distance of 0.3 "
            "from them"
        )


if __name__ == "__main__":
    main()
