"""Where heat was released, from temperatures that were measured later, in unbounded ground.

Physics: heat diffuses from two spots of different strength. Forty sensors record the temperature, with one percent of
noise. What was there at t = 0 follows from the gradient of the misfit by the initial data: two runs for all nodes at
once. It is not negative, and a small penalty on its sum prefers few warm places.

Prints the two warmest places with the heat around each, next to the true ones.

Run: ``python examples/released_heat.py``; half a minute.
"""

import numpy as np
from scipy.optimize import minimize

import farhorizon as fh

LATTICE = fh.Lattice(0.5, (-10.0, -10.0), (10.0, 10.0))
SPOTS = {(-3.0, 2.0): 4.0, (3.5, -1.5): 2.5}  # places, and heats
UNTIL, NOISE, PENALTY = 12.0, 0.01, 2e-4
X, Y = LATTICE.coordinates()


def ground(temperature: np.ndarray) -> fh.Setup:
    model = fh.Diffusion(fh.Kernel(1.0), diffusivity=1.0)
    return fh.Setup(LATTICE, model, fh.LatticePML(nodes=24), {"u": temperature}, dt=0.03)


def measured() -> fh.LeastSquares:
    rng = np.random.default_rng(3)
    sensors = fh.Receivers(rng.uniform(-6.5, 6.5, (40, 2)), every=10, interpolation="linear")
    true = sum(heat * np.exp(-((X - x) ** 2 + (Y - y) ** 2) / 0.5) / (0.5 * np.pi) for (x, y), heat in SPOTS.items())
    data = fh.Simulation.of(ground(true), observe=[sensors]).run(UNTIL, progress=False).recorders[0].data["u"]
    return fh.LeastSquares(sensors, data + NOISE * np.abs(data).max() * rng.standard_normal(data.shape))


def released(misfit: fh.LeastSquares, iterations: int = 60) -> np.ndarray:
    """Return the temperature at t = 0."""
    inner, start = (np.abs(X) < 8) & (np.abs(Y) < 8), np.zeros(LATTICE.shape)

    def cost(values: np.ndarray) -> tuple[float, np.ndarray]:
        start[inner] = values
        found = fh.gradient(ground(start), misfit, "u", UNTIL)
        return found.misfit + PENALTY * values.sum(), found["u"][inner] + PENALTY

    limits, options = [(0, None)] * int(inner.sum()), {"maxiter": iterations}
    start[inner] = minimize(cost, start[inner], jac=True, method="L-BFGS-B", bounds=limits, options=options).x
    return start


if __name__ == "__main__":
    left = released(measured())
    for (x, y), amount in SPOTS.items():
        near = np.hypot(X - X.flat[left.argmax()], Y - Y.flat[left.argmax()]) < 2
        heat, place = left[near].sum(), (np.stack([X, Y]) * left)[:, near].sum(1) / left[near].sum()
        print(f"heat {heat * LATTICE.spacing**2:.2f} at {place.round(2)}; true: {amount} at {(x, y)}")
        left[near] = 0
