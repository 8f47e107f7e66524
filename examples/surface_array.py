"""A crack under the surface of a half-space, imaged from an ultrasonic array on it.

Physics: each of eight elements of an array on the free surface sends a burst in turn, and all 33 record what comes
back. The crack, of length 17 at a depth of about 20, is open and not parallel to the surface. A reverse-time image, the
gradient by the density divided by the illumination, shows where the records differ from those of sound ground.

Prints where the image is largest below the array, and where the crack is.

Run: ``python examples/surface_array.py``; ten seconds.
"""

import numpy as np

import farhorizon as fh

LATTICE = fh.Lattice(1.0, (-48.0, -46.0), (48.0, 0.0))
CRACK = np.array([(2.3, -16.6), (17.2, -25.7)])
ELEMENTS = np.stack([np.linspace(-40.0, 40.0, 33), np.zeros(33)], axis=1)
BURST, UNTIL, DT = fh.Ricker(0.1), 90.0, 0.4
SIDES = {"all": fh.LatticePML(nodes=12), "y+": fh.Free()}


def ground(element: int, cracks: tuple = ()) -> fh.Setup:
    push = fh.PointSource(ELEMENTS[element], time=BURST)
    return fh.Setup(LATTICE, fh.Wave(fh.Kernel(2.0)), SIDES, sources=[push], cracks=cracks, dt=DT)


def shots(elements: int = 8) -> list[tuple[fh.Setup, fh.LeastSquares]]:
    """Return sound ground with what the array has recorded, for each element that sends."""
    found = []
    for element in np.linspace(0, len(ELEMENTS) - 1, elements).round().astype(int):
        line = fh.Receivers(ELEMENTS)
        fh.Simulation.of(ground(element, (CRACK,)), observe=[line]).run(UNTIL, progress=False)
        found.append((ground(element), fh.LeastSquares(line, line.data["u"])))
    return found


def imaged(given: list[tuple[fh.Setup, fh.LeastSquares]]) -> np.ndarray:
    """Return the image, zero beside the array."""
    return fh.image(given, UNTIL) * (LATTICE.coordinates()[1] < -6.0)


if __name__ == "__main__":
    image = imaged(shots())
    place = LATTICE.lower + np.unravel_index(np.abs(image).argmax(), image.shape)
    print(f"the image is largest at {place}; the crack runs from {CRACK[0]} to {CRACK[1]}")
