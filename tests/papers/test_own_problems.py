"""The methods of the papers on problems that are in none of them: another kernel, another domain, a hole, a crack or an
inclusion. Each run is compared with the same medium on a domain so wide that nothing returns, at the same time step.
"""

import numpy as np
import pytest

import farhorizon as fh

LINEAR = fh.Kernel(2.0, 1, "linear")
BELL = fh.Kernel(3.0, 0, "gaussian", 1.1)
HOLE, CRACK = fh.Disc(2.6, (-4.0, 2.0)), [(2.0, -5.0), (5.0, 1.5)]


def errors(setup, shape, sides, times, wide, body=None):
    """Largest differences of a near field of some half-widths, with a hole, from that of `wide` ones, and the largest
    values there.
    """

    def lattice(half):
        upper = np.array(half, float)
        whole = None if body is None else fh.Box(-upper - 1, upper + 1) - body
        return fh.Lattice(1.0, -upper, upper, body=whole)

    far = fh.Simulation(lattice(wide), boundary=fh.Fixed(), **setup)
    near = fh.Simulation(lattice(shape), boundary=sides, dt=far.dt, **setup)
    inner = tuple(slice(w - s, w + s + 1) for w, s in zip(wide, shape, strict=True))
    found = []
    for t in times:
        for sim in (far, near):
            sim.step(round(t / far.dt) - sim.step_count)
        exact = far.fields["u"][(..., *inner)]
        found.append((float(np.nanmax(np.abs(near.fields["u"] - exact))), float(np.nanmax(np.abs(exact)))))
    return np.array(found).T


PULSE = {"u": "exp(-(x - 1)**2/4)"}


@pytest.mark.parametrize("kernel", [LINEAR, BELL], ids=["linear", "gaussian"])
def test_exact_ends_of_ji(kernel):
    """A bar with a stiff inclusion and a damped medium."""
    inclusion = lambda n: np.where(np.abs(np.arange(-n, n + 1) + 4) < 2.5, 3.0, 1.0)  # noqa: E731 (by its place)
    model = fh.Wave(kernel, damping=0.02)
    found = []
    for half, sides in ((90, fh.Fixed()), (12, fh.Exact())):
        dt = found[0].dt if found else None
        found.append(
            fh.Simulation(fh.Lattice(1.0, -half, half), model, sides, PULSE, coefficient=inclusion(half), dt=dt)
        )
    for t in (10.0, 40.0, 70.0):
        for sim in found:
            sim.run(until=t, progress=False)
        assert np.abs(found[1].fields["u"] - found[0].fields["u"][78:-78]).max() < 1e-11


@pytest.mark.parametrize("kernel", [LINEAR, BELL], ids=["linear", "gaussian"])
def test_plane_waves_of_hermann(kernel):
    """A rectangle with a hole and a crack. The page on conditions says 4e-4 to 4e-3 of the initial maximum; what is
    scattered arrives at more angles.
    """
    start = {"u": "exp(-((x - 3)**2 + y**2)/6)"}
    setup = {"model": fh.Wave(kernel, damping=0.01), "initial": start, "cracks": [CRACK]}
    error, _ = errors(setup, (16, 13), fh.PlaneWave(), (15.0, 25.0, 35.0), (45, 42), HOLE)
    assert error.max() < 1e-2


@pytest.mark.parametrize("kernel", [LINEAR, BELL], ids=["linear", "gaussian"])
def test_decaying_modes_of_shojaei_and_heat_of_bobaru(kernel):
    """The same for diffusion until R^2 / (2 D) = 84: a few per cent of what is left, where a lattice PML is right to
    1e-7, as the page on conditions says; heat spreads around the hole and through the crack's ends.
    """
    start = {"u": "exp(-((x - 3)**2 + y**2)/6)"}
    setup = {"model": fh.Heat(kernel), "initial": start, "cracks": [CRACK]}
    for sides, bound in ((fh.PlaneWave(), 0.1), (fh.LatticePML(nodes=16), 1e-7)):
        error, left = errors(setup, (16, 13), sides, (20.0, 40.0, 80.0), (70, 67), HOLE)
        assert (error < bound * left).all()


@pytest.mark.parametrize("kernel", [LINEAR, pytest.param(BELL, marks=pytest.mark.slow)], ids=["linear", "gaussian"])
def test_nonlocal_layer_of_wildman(kernel):
    """A correspondence solid with a crack: less than a hundredth of what a fixed edge sends back, as for the examples
    in the page on accuracy.
    """
    model = fh.Elastic(kernel, young=1.0, poisson=0.3, material="correspondence")
    start = {"u": ["exp(-((x - 3)**2 + y**2)/8)", "0*x"]}
    setup = {"model": model, "initial": start, "cracks": [CRACK]}
    error, edge = (
        errors(setup, (18, 16), sides, (15.0, 25.0, 35.0), (60, 58))[0].max()
        for sides in (fh.NonlocalPML(16), fh.Fixed())
    )
    assert error < 0.01 * edge
