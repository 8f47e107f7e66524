"""Moment tensor and place of an event from seismograms at the surface and in a borehole.

Physics: P and S waves in a half-space. An event that is neither an explosion nor a double couple occurs 24 below its
free surface. Sent back in time, the noisy records of twelve stations meet near it; from there, the gradient of the
misfit by place and tensor leads to both: two runs for all five unknowns at once.

Prints both, next to the true ones. Run: ``python examples/event_location.py``; ten seconds.
"""

import numpy as np
from scipy.optimize import minimize

import farhorizon as fh

LATTICE = fh.Lattice(1.0, (-36.0, -44.0), (36.0, 0.0))
GROUND = fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.2, material="state-based")
SIDES, PULSE = {"all": fh.LatticePML(nodes=12), "y+": fh.Free()}, fh.Ricker(0.05)
UNTIL, NOISE, LENGTH = 110.0, 0.05, 4.0  # an unknown of 1 is a place that is so far away
PLACE, TENSOR = np.array([5.3, -24.4]), np.array([[1.0, 0.6], [0.6, -0.4]])
STATIONS = [(x, 0.0) for x in np.linspace(-28, 28, 9)] + [(20.0, y) for y in (-12.0, -22.0, -32.0)]


def ground(*sources: fh.MomentTensor) -> fh.Setup:
    return fh.Setup(LATTICE, GROUND, SIDES, sources=sources, dt=0.5)


def seismograms() -> fh.LeastSquares:
    line, rng = fh.Receivers(STATIONS), np.random.default_rng(1)
    fh.Simulation.of(ground(fh.MomentTensor(PLACE, TENSOR, PULSE)), observe=[line]).run(UNTIL, progress=False)
    data = line.data["u"]
    return fh.LeastSquares(line, data + NOISE * np.abs(data).max() * rng.standard_normal(data.shape))


def meeting(image: np.ndarray) -> np.ndarray:
    """Return where the reversed records meet, away from the stations and between nodes."""
    apart = np.min([np.hypot(*(np.stack(LATTICE.coordinates(), -1) - place).T).T for place in STATIONS], axis=0)
    return LATTICE.lower + np.unravel_index(np.where(apart > 8.0, image, 0.0).argmax(), image.shape) + 0.25


def located(misfit: fh.LeastSquares, start: np.ndarray, iterations: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Return the place and the tensor, from one place and no tensor."""

    def cost(unknown: np.ndarray) -> tuple[float, np.ndarray]:
        event = fh.MomentTensor(start + LENGTH * unknown[:2], unknown[[2, 3, 3, 4]].reshape(2, 2), PULSE)
        found = fh.gradient(ground(event), misfit, ["source.at", "source.moment"], UNTIL)
        (xx, xy), (yx, yy) = found["source.moment"]
        return found.misfit, np.array([*LENGTH * found["source.at"], xx, xy + yx, yy])

    end = minimize(cost, np.zeros(5), jac=True, method="L-BFGS-B", options={"maxiter": iterations, "ftol": 1e-9}).x
    return start + LENGTH * end[:2], end[[2, 3, 3, 4]].reshape(2, 2)


if __name__ == "__main__":
    records = seismograms()
    first = meeting(fh.image([(ground(), records)], UNTIL, show="sources"))
    place, tensor = located(records, first)
    print(f"place: {first} where records meet, {place.round(2)} by the gradient; true: {PLACE}")
    print(f"tensor: {tensor.round(2).tolist()}; true: {TENSOR.tolist()}")
