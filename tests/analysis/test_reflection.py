"""Reflection of plane waves: the exact half-infinite problem against closed forms, energy, and time runs."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.chain import Recursion
from farhorizon.analysis.reflection import chain_modes, chain_weights, factor_of_wave
from farhorizon.compare import compare
from farhorizon.integrators import Verlet
from farhorizon.strip import Strip


def strip(model, boundary, dim=2, width=None):
    """A near field of unit spacing whose high side is the boundary."""
    reach = max(model.stencil(1.0, dim).reach)
    lattice = fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 4,) * dim)
    sim = fh.Simulation(lattice, model, boundary={"all": fh.Fixed(), "x+": boundary})
    return Strip(sim, 0, width or 2 * reach + 2)


def closed_form(found, layer, wavelength, angle):
    """5-point stencil: each edge but the last takes ((1 - x)/(1 + x))^2, the last ends the layer and takes one factor, x = g tanh(i k/2)."""
    number, dt = 2 * np.pi / wavelength, found.dt
    normal, along = number * np.cos(np.radians(angle)), number * np.sin(np.radians(angle))
    omega = np.arccos(1 - dt**2 * float(found.sim.stencil.symbol(normal, along)) / 2) / dt
    s = -2j / dt * np.tan(omega * dt / 2)  # the trapezoidal rule's
    x = -(layer.kappa + layer.sigma / (s + layer.alpha)) * 1j * np.tan(normal / 2)
    share = (1 - x) / (1 + x)
    return abs(np.prod(share[:-1]) ** 2 * share[-1])


@pytest.mark.parametrize("angle", [0, 30, 60, 75])
@pytest.mark.parametrize("profile", [{"sigma": [0.1, 0.3, 0.5, 0.7]}, {"sigma": 0.4, "alpha": 0.05, "kappa": [1.0, 1.5, 2.0, 2.5]}])
def test_one_neighbour_in_closed_form(profile, angle):
    model = fh.Wave(fh.Stencil.finite_difference(2))
    found = strip(model, fh.LatticePML(nodes=3, profile=profile))
    layer = next(iter(found.sim.engine.layers.values()))
    for wavelength in (5.0, 8.0, 30.0):
        assert abs(found.reflection(wavelength, angle)) == pytest.approx(closed_form(found, layer, wavelength, angle), rel=1e-9)


@pytest.mark.parametrize("side", [fh.Fixed(), fh.Free()])
@pytest.mark.parametrize("reach, exponent", [(1, 2), (3, 2), (4, 3)])
def test_all_of_a_wave_comes_back_where_none_is_lost(side, reach, exponent):
    """Energy: a fixed and a free end send back all, whatever evanescent modes they need."""
    found = strip(fh.Wave(fh.Kernel(float(reach), exponent)), side)
    for wavelength, angle in ((6, 0), (6, 40), (12, 75), (50, 20)):
        assert abs(found.reflection(wavelength, angle)) == pytest.approx(1.0, rel=1e-9)


def test_a_thick_layer_sends_nothing_back():
    """In 1D 40 nodes leave less than the run's rounding, with all evanescent modes of reach 3."""
    assert abs(strip(fh.Wave(fh.Kernel(3.0)), fh.LatticePML(nodes=40), dim=1).reflection(8.0, 0.0)) < 1e-12


def test_modes_solve_the_equation_and_are_sorted_by_where_they_go():
    """2 K modes: half come to the side, half leave it; with growth in time those that come fall off towards it."""
    stencil = fh.Stencil.from_kernel(fh.Kernel(3.0, 0), 1.0, 2)
    recursion = Recursion.of(Verlet(), 0.3 * Verlet.step_limit(stencil.symbol_maximum))
    for along in (0.0, 0.4):
        weights = chain_weights(stencil, [along])
        factor = factor_of_wave(-float(stencil.symbol(0.5, along)), recursion)
        assert abs(factor) == pytest.approx(1.0, abs=1e-14) and factor.imag < 0
        modes = chain_modes(weights, factor, recursion, np.exp(0.5j))
        assert modes.incoming == pytest.approx(np.exp(0.5j)) and len(modes.leaving) == 3
        powers = np.arange(-3, 4)
        for zeta in (modes.incoming, *modes.leaving):
            assert (weights * zeta**powers).sum() == pytest.approx(recursion.eigenvalue(np.array(factor)), abs=1e-10)
        grown = chain_modes(weights, factor * (1 + 1e-4), recursion, np.exp(0.5j))
        assert abs(grown.incoming) < 1 and (np.abs(grown.leaving) > 1).all()


def test_a_backward_wave_comes_with_its_phase_running_away():
    """Exponent 0: at a wavelength of 3.5 spacings group and phase velocity are opposite; the wave that comes is the mirror image."""
    stencil = fh.Stencil.from_kernel(fh.Kernel(3.0, 0), 1.0, 1)
    recursion = Recursion.of(Verlet(), 0.3 * Verlet.step_limit(stencil.symbol_maximum))
    number = 2 * np.pi / 3.5
    assert stencil.symbol_gradient(0, number) < 0
    factor = factor_of_wave(-float(stencil.symbol(number)), recursion)
    assert chain_modes(chain_weights(stencil, []), factor, recursion, np.exp(1j * number)).incoming == pytest.approx(np.exp(-1j * number))


def measured(model, boundary, rows, angle, width=40.0):
    """Reflected amplitude in a time run and the wavelength: a packet under an angle, less the exact incident one, at the carrier's frequency.

    The tangential wavenumber is that of a period of `rows` nodes, 0 for normal incidence.
    """
    along = 2 * np.pi / rows if angle else 0.0
    normal = along / np.tan(np.radians(angle)) if angle else 2 * np.pi / rows
    reach = max(model.stencil(1.0, 2).reach)
    length = int(14 * width)
    lattice = fh.Lattice(1.0, (1.0 - length, 0.0), (0.0, (rows if angle else 2 * reach + 1) - 1.0))
    quiet = {"x-": fh.LatticePML(nodes=30), "x+": boundary, "y": fh.Periodic()}
    dt = fh.Simulation(lattice, model, boundary=quiet).dt
    wavenumbers = 2 * np.pi * np.fft.fftfreq(8 * length)
    centre = -7.0 * width
    spectrum = np.exp(-((wavenumbers - normal) ** 2) * width**2 / 2 - 1j * (wavenumbers - normal) * centre)
    spectrum[np.abs(spectrum) < 1e-18] = 0
    used = np.flatnonzero(spectrum)
    number, amplitude = wavenumbers[used], spectrum[used] / np.abs(spectrum).sum()
    symbol = model.coefficient * model.stencil(1.0, 2).symbol(number, along * np.ones_like(number))
    omega = np.arccos(1 - dt**2 * symbol / 2) / dt * np.sign(number)
    x, y = lattice.coordinates()
    waves = np.exp(1j * x[:, :1] * number)
    sim = fh.Simulation(lattice, model, boundary=quiet, dt=dt, initial={
        "u": (waves @ amplitude).real[:, None] * np.cos(along * y),
        "v": (waves @ (-1j * np.sin(omega * dt) / dt * amplitude)).real[:, None] * np.cos(along * y),
    })  # fmt: skip
    carrier = int(np.argmin(np.abs(number - normal)))
    slope = model.coefficient * model.stencil(1.0, 2).symbol_gradient(0, number[carrier], along)
    speed = slope / (2 * omega[carrier])  # to leading order in dt
    probe, steps = -2 * reach - 8, int(2.2 * 7 * width / speed / dt)
    seen = np.empty(steps)
    for n in range(steps):
        seen[n] = sim.fields["u"][probe - 1, 0]
        sim.step()
    times = dt * np.arange(steps)
    incident = (np.exp(1j * (number * probe - times[:, None] * omega)) @ amplitude).real
    ring = np.exp(1j * omega[carrier] * times)
    wavelength = 2 * np.pi / np.hypot(number[carrier], along)
    return abs((seen - incident) @ ring) / abs(incident @ ring), wavelength, np.degrees(np.arctan2(along, number[carrier]))


RUNS = [(fh.Stencil.finite_difference(2), 8, 12, 0), (fh.Kernel(3.0), 6, 12, 0), (fh.Kernel(3.0), 8, 12, 30), (fh.Kernel(3.0), 12, 10, 75)]
MORE = [(fh.Kernel(3.0), 8, 12, 45), (fh.Kernel(2.0), 8, 10, 60), (fh.Stencil.finite_difference(2), 6, 10, 60), (fh.Kernel(3.0, 1), 6, 16, 45)]


@pytest.mark.parametrize("operator, nodes, rows, angle", [*RUNS, *(pytest.param(*m, marks=pytest.mark.slow) for m in MORE)])
def test_time_run(operator, nodes, rows, angle):
    """Predicted and measured within 1 dB, down to 1e-7 and below, up to 75 degrees."""
    model = fh.Wave(operator)
    boundary = fh.LatticePML(nodes=nodes)
    found, wavelength, direction = measured(model, boundary, rows, angle, 60.0 if angle > 70 else 40.0)
    predicted = abs(strip(model, boundary).reflection(wavelength, direction))
    assert abs(20 * np.log10(found / predicted)) < 1.0


@pytest.mark.parametrize("nodes", [8, 12])
def test_what_comes_back_from_a_corner(nodes):
    """A packet that runs into the corner between two layers under 45 degrees: less comes back than a side alone would send.

    A corner has no closed form; a run against the infinite lattice has the amplitude. To turn back a wave must be sent back by both sides.
    """
    model, width, wavelength = fh.Wave(fh.Kernel(3.0)), 9.0, 10.0
    half = 60
    lattice = fh.Lattice(1.0, (-half, -half), (half, half))
    sim = fh.Simulation(lattice, model, boundary=fh.LatticePML(nodes=nodes))
    x, y = lattice.coordinates()
    number = 2 * np.pi / wavelength * np.sqrt(0.5)
    packet = np.exp(-(x**2 + y**2) / (2 * width**2) + 1j * number * (x + y))
    angles = np.ix_(*(2 * np.pi * np.fft.fftfreq(n) for n in lattice.shape))
    omega = np.arccos(1 - sim.dt**2 * sim.stencil.symbol(*angles) / 2) / sim.dt
    velocity = np.fft.ifft2(-1j * np.sin(omega * sim.dt) / sim.dt * np.fft.fft2(packet))  # of waves that move towards the corner
    setup = {"lattice": lattice, "model": model, "boundary": fh.LatticePML(nodes=nodes), "dt": sim.dt,
             "initial": {"u": packet.real, "v": np.where(np.abs(velocity.real) > 1e-12, velocity.real, 0.0)}}  # fmt: skip
    times = np.linspace(50, 200, 16)
    curve = next(iter(compare(setup, 200.0, times, beside=False).curves.values()))
    assert 0 < max(curve["error_rel_initial"]) <= abs(strip(model, fh.LatticePML(nodes=nodes)).reflection(wavelength, 45.0))
