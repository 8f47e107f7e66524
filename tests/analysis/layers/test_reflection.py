"""Reflection of plane waves: the exact half-infinite problem against closed forms, energy and time-domain runs, and
the equations of a lattice PML itself against the engine's complete map.
"""

import os

import numpy as np
import pytest
from scipy import optimize

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.chain_modes import LatticeMedium, chain_modes, chain_weights, factor_of_wave
from farhorizon.analysis.layers.reflection import LayerSide, continuations, layer_amplitudes
from farhorizon.checks.reduced_setups import Strip, pinned
from farhorizon.medium.integrators import Verlet
from farhorizon.studies.compare import compare


def strip(model, boundary, dim=2, width=None):
    """A near field of unit spacing whose upper side is the given boundary."""
    reach = max(model.stencil(1.0, dim).reach)
    lattice = fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 4,) * dim)
    sim = fh.Simulation(lattice, model, boundary={"all": fh.Fixed(), "x+": boundary})
    return Strip(sim, 0, width or 2 * reach + 2)


def closed_form(found, layer, wavelength, angle):
    """Reflection for the 5-point stencil, with x = g tanh(i k/2): each edge but the last contributes ((1 - x)/(1 +
    x))^2, and the last one, where the layer ends, a single factor.
    """
    number, dt = 2 * np.pi / wavelength, found.dt
    normal, along = number * np.cos(np.radians(angle)), number * np.sin(np.radians(angle))
    omega = np.arccos(1 - dt**2 * float(found.sim.stencil.symbol(normal, along)) / 2) / dt
    s = -2j / dt * np.tan(omega * dt / 2)  # of the trapezoidal rule
    x = -(layer.kappa + layer.sigma / (s + layer.alpha)) * 1j * np.tan(normal / 2)
    share = (1 - x) / (1 + x)
    return abs(np.prod(share[:-1]) ** 2 * share[-1])


@pytest.mark.parametrize("angle", [0, 30, 60, 75])
@pytest.mark.parametrize(
    "profile", [{"sigma": [0.1, 0.3, 0.5, 0.7]}, {"sigma": 0.4, "alpha": 0.05, "kappa": [1.0, 1.5, 2.0, 2.5]}]
)
def test_one_neighbour_in_closed_form(profile, angle):
    model = fh.Wave(fh.Stencil.finite_difference(2))
    found = strip(model, fh.LatticePML(nodes=3, profile=profile))
    layer = next(iter(found.sim.engine.layers.values()))
    for wavelength in (5.0, 8.0, 30.0):
        assert abs(found.reflection(wavelength, angle)) == pytest.approx(
            closed_form(found, layer, wavelength, angle), rel=1e-9
        )


@pytest.mark.parametrize("side", [fh.Fixed(), fh.Free()])
@pytest.mark.parametrize("reach, exponent", [(1, 2), (3, 2), (4, 3)])
def test_all_of_a_wave_comes_back_where_none_is_lost(side, reach, exponent):
    """By conservation of energy, fixed and free ends reflect everything, whatever evanescent modes they need."""
    found = strip(fh.Wave(fh.Kernel(float(reach), exponent)), side)
    for wavelength, angle in ((6, 0), (6, 40), (12, 75), (50, 20)):
        assert abs(found.reflection(wavelength, angle)) == pytest.approx(1.0, rel=1e-9)


def test_a_thick_layer_sends_nothing_back():
    """In 1D with reach 3, 40 nodes reflect less than the rounding of a run, all evanescent modes included."""
    assert abs(strip(fh.Wave(fh.Kernel(3.0)), fh.LatticePML(nodes=40), dim=1).reflection(8.0, 0.0)) < 1e-12


def test_modes_solve_the_equation_and_are_sorted_by_where_they_go():
    """Of the 2 K modes half travel or decay towards the side and half away from it. With growth in time the incoming
    ones decay towards the side.
    """
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
    """With exponent 0, group and phase velocity are opposite at a wavelength of 3.5 spacings; the incoming wave is the
    mirror image.
    """
    stencil = fh.Stencil.from_kernel(fh.Kernel(3.0, 0), 1.0, 1)
    recursion = Recursion.of(Verlet(), 0.3 * Verlet.step_limit(stencil.symbol_maximum))
    number = 2 * np.pi / 3.5
    assert stencil.symbol_gradient(0, number) < 0
    factor = factor_of_wave(-float(stencil.symbol(number)), recursion)
    modes = chain_modes(chain_weights(stencil, []), factor, recursion, np.exp(1j * number))
    assert modes.incoming == pytest.approx(np.exp(-1j * number))


@pytest.mark.parametrize("detuned", [0.8, 0.95, 1.05, 1.25])
def test_a_wave_is_told_from_one_at_right_angles_to_it(detuned):
    """In a plane of symmetry the S waves have almost the same wavenumber. Each is identified by its polarisation, from
    a guess that may be nearer to the other.
    """
    stencil = fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element").stencil(1.0, 3)
    recursion = Recursion.of(Verlet(), 0.3 * Verlet.step_limit(stencil.symbol_maximum))
    number, along = 0.9, 0.5
    values, vectors = np.linalg.eigh(stencil.symbol(number, along, 0.0))
    for value, vector in zip(values, vectors.T, strict=True):
        factor = factor_of_wave(-float(value), recursion)
        weights = chain_weights(stencil, [along, 0.0])
        modes = chain_modes(weights, factor, recursion, np.exp(1j * number * detuned), vector)
        assert modes.incoming == pytest.approx(np.exp(1j * number), abs=1e-9)
        assert abs(np.vdot(modes.vector, vector)) == pytest.approx(1.0, abs=1e-9)


def wave(stencil, branch, eigenvalue, along):
    """Normal wavenumber (positive), polarisation and flux over amplitude squared of a long wave of given frequency and
    tangential wavenumber.
    """
    normal = optimize.brentq(lambda k: stencil.branches(k, along)[branch] - eigenvalue, 0.0, 2.0, xtol=1e-14)
    symbol = stencil.symbol(normal, along).reshape(stencil.components, -1)
    vector = np.linalg.eigh(symbol)[1][:, branch]
    slope = stencil.symbol_gradient(0, normal, along).reshape(symbol.shape)
    return normal, vector, float((vector.conj() @ slope @ vector).real)


def measured(model, boundary, rows, angle, width=40.0, incoming=""):
    """Reflected amplitudes by type in a time-domain run, at the carrier wave of an oblique packet from which the exact
    incident one is subtracted; also the wavelength and the direction.

    The tangential wavenumber is that of a period of `rows` nodes, 0 for normal incidence.
    """
    stencil, types = model.stencil(1.0, 2), {"": 0} if model.stencil(1.0, 2).components == 1 else {"P": 1, "S": 0}
    branch = types[incoming]
    along = 2 * np.pi / rows if angle else 0.0
    normal = along / np.tan(np.radians(angle)) if angle else 2 * np.pi / rows
    reach = max(stencil.reach)
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
    values, vectors = np.linalg.eigh(
        stencil.symbol(number, along * np.ones_like(number)).reshape(len(number), len(types), -1)
    )
    carrier = int(np.argmin(np.abs(number - normal)))
    # one sign for the whole packet
    vectors = vectors[:, :, branch] * np.sign(vectors[:, :, branch] @ vectors[carrier, :, branch])[:, None]
    omega = np.arccos(1 - dt**2 * model.coefficient * values[:, branch] / 2) / dt * np.sign(number)
    x, y = lattice.coordinates()
    waves, across = np.exp(1j * x[:, 0, None] * number), np.exp(1j * along * y[:1])

    def field(factor):
        found = np.array([((waves @ (factor * amplitude * v))[:, None] * across).real for v in vectors.T])
        return np.where(np.abs(found) > 1e-13, found, 0.0) if incoming else found[0]

    sim = fh.Simulation(
        lattice, model, boundary=quiet, dt=dt, initial={"u": field(1.0), "v": field(-1j * np.sin(omega * dt) / dt)}
    )
    frequency = values[carrier, branch]
    back = {
        name: wave(stencil, b, frequency, along)
        for name, b in types.items()
        if stencil.branches(0.0, along)[b] < frequency
    }
    # velocity of the slowest reflected wave, to leading order in dt
    speed = model.coefficient * min(flux for *_, flux in back.values()) / (2 * omega[carrier])
    probe, steps = -2 * reach - 8, int((7 * width / abs(speed) + 7.5 * width / speed) / dt)
    seen = np.empty((steps, len(types)), complex)
    for n in range(steps):
        row = sim.fields["u"].reshape(len(types), *lattice.shape)[:, probe - 1]
        seen[n] = (2 if angle else 1) * (row / across).mean(-1)
        sim.step()
    times = dt * np.arange(steps)
    phases = np.exp(1j * (number * probe - times[:, None] * omega)) @ (amplitude[:, None] * vectors)
    incident = phases if angle else phases.real
    ring = np.exp(1j * omega[carrier] * times)
    mirror = np.where(np.arange(len(types)) == 0, -1, 1) if incoming else 1
    shapes = np.array([vector * mirror for _, vector, _ in back.values()])
    found = np.linalg.lstsq(shapes.T, ring @ (seen - incident), rcond=None)[0] / np.linalg.norm(ring @ incident)
    wavelength = 2 * np.pi / np.hypot(number[carrier], along)
    return dict(zip(back, np.abs(found), strict=True)), wavelength, np.degrees(np.arctan2(along, number[carrier]))


def decibels(found, predicted):
    """Difference in decibels between a measured amplitude and a predicted one; shown by ``pytest -rP``."""
    difference = 20 * np.log10(found / predicted)
    print(f"predicted {predicted:.2e}, measured {difference:+.2f} dB off")
    return difference


RUNS = [
    (fh.Stencil.finite_difference(2), 8, 12, 0),
    (fh.Kernel(3.0), 6, 12, 0),
    (fh.Kernel(3.0), 8, 12, 30),
    (fh.Kernel(3.0), 12, 10, 75),
]
MORE = [
    (fh.Kernel(3.0), 8, 12, 45),
    (fh.Kernel(2.0), 8, 10, 60),
    (fh.Stencil.finite_difference(2), 6, 10, 60),
    (fh.Kernel(3.0, 1), 6, 16, 45),
]


@pytest.mark.parametrize(
    "operator, nodes, rows, angle", [*RUNS, *(pytest.param(*m, marks=pytest.mark.slow) for m in MORE)]
)
def test_time_run(operator, nodes, rows, angle):
    """Prediction and measurement agree within 1 dB, down to 1e-7 and below and up to 75 degrees."""
    model = fh.Wave(operator)
    boundary = fh.LatticePML(nodes=nodes)
    found, wavelength, direction = measured(model, boundary, rows, angle, 60.0 if angle > 70 else 40.0)
    predicted = abs(strip(model, boundary).reflection(wavelength, direction))
    assert abs(decibels(found[""], predicted)) < 1.0


BONDS, ELEMENTS = fh.Elastic(fh.Kernel(3.0, 1), 1.0), fh.Elastic(None, 1.0, 0.3, material="finite-element")
PLASTIC = fh.Elastic(
    fh.Kernel(3.0, 0, "gaussian", volume="full"), 1.0, 0.3, material="correspondence", stabilisation=0.5
)
SOLIDS = [(BONDS, "P", 6, 20, 30), (ELEMENTS, "S", 6, 16, 25)]
MORE_SOLIDS = [(BONDS, "S", 6, 12, 60), (PLASTIC, "P", 8, 14, 60), (BONDS, "P", 8, 12, 0), (ELEMENTS, "P", 8, 12, 75)]


@pytest.mark.parametrize(
    "model, incoming, nodes, rows, angle", [*SOLIDS, *(pytest.param(*m, marks=pytest.mark.slow) for m in MORE_SOLIDS)]
)
def test_time_run_of_vectors(model, incoming, nodes, rows, angle):
    """The P and S waves that a layer reflects for either incident type agree with the prediction within 1 dB."""
    boundary = fh.LatticePML(nodes=nodes)
    found, wavelength, direction = measured(model, boundary, rows, angle, 60.0 if angle > 70 else 40.0, incoming)
    predicted = strip(model, boundary).reflections(wavelength, direction, incoming=incoming)
    assert set(found) == set(predicted)
    for name in found if angle else incoming:  # no conversion at normal incidence
        assert abs(decibels(found[name], abs(predicted[name]))) < 1.0


@pytest.mark.parametrize("model", [BONDS, ELEMENTS, PLASTIC])
def test_energy_and_reciprocity_of_a_fixed_side(model):
    """The fluxes of the reflected P and S waves add up to that of the incident one, and conversion from P to S and
    from S to P carries the same share.
    """
    found, stencil = strip(model, fh.Fixed()), model.stencil(1.0, 2)
    branches = {"P": 1, "S": 0}
    for wavelength, angle in ((10.0, 20.0), (12.0, 50.0), (30.0, 70.0)):
        along = 2 * np.pi / wavelength * np.sin(np.radians(angle))
        frequency = stencil.branches(2 * np.pi / wavelength * np.cos(np.radians(angle)), along)[1]
        waves = {name: wave(stencil, branch, frequency, along) for name, branch in branches.items()}
        shares = {}
        for name, (normal, _, flux) in waves.items():
            back = found.reflections(
                2 * np.pi / np.hypot(normal, along), np.degrees(np.arctan2(along, normal)), incoming=name
            )
            shares[name] = {other: abs(a) ** 2 * waves[other][2] / flux for other, a in back.items()}
            assert sum(shares[name].values()) == pytest.approx(1.0, rel=1e-9)
        assert shares["P"]["S"] == pytest.approx(shares["S"]["P"], rel=1e-9) and shares["P"]["S"] > 0.05


def test_long_waves_at_a_fixed_side_follow_the_continuum():
    """The fixed side converges to the rigid boundary of classical elasticity with second order in the wavenumber."""
    found, angle = strip(ELEMENTS, fh.Fixed()), np.radians(35.0)
    ratio = np.sqrt((1 - 2 * 0.3) / (2 - 2 * 0.3))  # ratio of the speeds at Poisson's ratio 0.3
    slow = np.arcsin(ratio * np.sin(angle))
    p, s = np.linalg.solve(
        [[-np.cos(angle), np.sin(slow)], [np.sin(angle), np.cos(slow)]], [-np.cos(angle), -np.sin(angle)]
    )
    lengths, errors = np.array([15.0, 30.0, 60.0]), []
    for wavelength in lengths:
        back = found.reflections(float(wavelength), 35.0)
        errors.append(np.hypot(abs(back["P"]) - abs(p), abs(back["S"]) - abs(s)))
    assert np.polyfit(np.log(lengths), np.log(errors), 1)[0] == pytest.approx(-2.0, abs=0.1)


def test_types_in_space():
    """In a plane of symmetry SH waves are not converted. At normal incidence nothing is converted, and both S waves
    are reflected alike.
    """
    found = strip(fh.Elastic(fh.Kernel(1.0, 1), 1.0), fh.LatticePML(nodes=6), 3)
    assert found.types == ("P", "SV", "SH")
    slanted = {name: found.reflections(12.0, 20.0, incoming=name) for name in found.types}
    assert (
        abs(slanted["SH"]["P"]) + abs(slanted["SH"]["SV"]) + abs(slanted["P"]["SH"]) + abs(slanted["SV"]["SH"]) < 1e-12
    )
    assert min(abs(slanted["P"]["SV"]), abs(slanted["SV"]["P"])) > 1e-9
    straight = {name: found.reflections(12.0, 0.0, incoming=name) for name in found.types}
    assert max(abs(a) for name in straight for other, a in straight[name].items() if other != name) < 1e-12
    assert abs(straight["SV"]["SV"]) == pytest.approx(abs(straight["SH"]["SH"]), rel=1e-6)
    turned = found.reflections(12.0, 20.0, 90.0, "SH")  # the two tangential axes are equivalent
    assert abs(turned["SH"]) == pytest.approx(abs(slanted["SH"]["SH"]), rel=1e-6)


@pytest.mark.parametrize("nodes", [8, 12])
def test_what_comes_back_from_a_corner(nodes):
    """A packet that runs at 45 degrees into the corner between two layers is reflected less than by a side alone.

    A corner has no closed form, so the amplitude comes from a run against the infinite lattice. To turn back, a wave
    must be reflected by both sides.
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
    # of waves that travel towards the corner
    velocity = np.fft.ifft2(-1j * np.sin(omega * sim.dt) / sim.dt * np.fft.fft2(packet))
    setup = {
        "lattice": lattice,
        "model": model,
        "boundary": fh.LatticePML(nodes=nodes),
        "dt": sim.dt,
        "initial": {"u": packet.real, "v": np.where(np.abs(velocity.real) > 1e-12, velocity.real, 0.0)},
    }
    times = np.linspace(50, 200, 16)
    curve = next(iter(compare(setup, 200.0, times, beside=False).curves.values()))
    assert (
        0
        < max(curve["error_rel_initial"])
        <= abs(strip(model, fh.LatticePML(nodes=nodes)).reflection(wavelength, 45.0))
    )


SCALAR = [(1, fh.Kernel(3.0, 0)), (2, fh.Kernel(3.0, 1)), (2, fh.Stencil.finite_element(2)), (3, fh.Kernel(2.0))]
VECTORS = [
    (2, fh.Elastic(fh.Kernel(3.0, 1), young=1.0)),
    (2, fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based")),
    (2, fh.Elastic(young=1.0, poisson=0.3, material="finite-element")),
    # the waves themselves are damped
    (2, fh.Elastic(fh.Kernel(1.5, 0, "gaussian", volume="full"), young=1.0, poisson=0.25, material="correspondence")),
    (3, fh.Elastic(fh.Kernel(1.0, 1), young=1.0)),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("dim, model", [(dim, fh.Wave(operator, damping=0.01)) for dim, operator in SCALAR] + VECTORS)
def test_the_layers_equations_are_what_the_engine_steps(dim, model):
    """Reflections between all types of waves, with damped short waves included."""
    reach = max(model.stencil(1.0, dim).reach)
    lattice = fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 2,) * dim)
    sim = fh.Simulation(lattice, model, boundary=fh.LatticePML(nodes=9))
    layer = sim.engine.layers[3 - dim, 1]
    assert layer.damping.max() > 0
    strip = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    side = LayerSide(strip.medium, layer)
    for wavelength, angle in ((9.0, 0.0), (14.0, 35.0), (40.0, 75.0)):
        if dim == 1 and angle:
            continue
        for incoming in side.types:
            given, azimuth = (wavelength, angle), 30.0 if dim == 3 else 0.0
            expected = strip.reflections(*given, azimuth, incoming=incoming)
            found = side.reflections(*given, azimuth, incoming=incoming)
            assert found.keys() == expected.keys()
            assert all(abs(found[k] - expected[k]) <= 1e-6 * abs(expected[k]) + 1e-12 for k in expected), (
                incoming,
                found,
                expected,
            )


@pytest.mark.parametrize("dim, reach", [(1, 1), (1, 3), (2, 2)])
def test_what_comes_back_of_a_diffusion_wave(dim, reach):
    """A source of one frequency in front of a layer: the engine's operator with the layer against the infinite lattice
    by FFT.
    """
    # nodes from the source and from the probe to the side, and of a ring so long that nothing travels around it
    place, inside, count = 30, 12, 4096
    lattice = fh.Lattice(1.0, (0.0,) * dim, (79.0,) * dim)
    sim = fh.Simulation(
        lattice, fh.Diffusion(fh.Kernel(float(reach)), integrator="euler"), boundary=fh.LatticePML(nodes=8)
    )
    strip = Strip(sim, 0, 80)
    side = LayerSide(
        LatticeMedium(sim.stencil, 1.0, 1.0, Recursion(0.0, sim.dt, 1.0), sim.dt),
        sim.engine.layers[3 - dim, 1],
        diffusive=True,
    )
    nodes = strip.near[0]
    distance = np.abs(np.arange(len(nodes)) - (len(nodes) - 1 - place))
    for wavelength, angle in ((40.0, 0.0), (60.0, 45.0), (60.0, 75.0)):
        if dim == 1 and angle:
            continue
        wave = side.medium.diffusion_wave(wavelength, angle)
        source = np.zeros(strip.size)
        source[nodes[-1 - place]] = 1
        change = (strip.matrix(*wave.along) - np.eye(strip.size)) / sim.dt
        field = np.linalg.solve(wave.eigenvalue * np.eye(strip.size) - change, source)[nodes]
        around = 2 * np.pi * np.arange(count) / count
        endless = np.fft.ifft(
            1 / (wave.eigenvalue + sim.stencil.symbol(around, *[np.full(count, a) for a in wave.along]))
        )
        expected = endless[distance]
        found = side.reflections(wavelength, angle)[""]
        # where modes that are short-lived at the face have died out
        back, away = (field - expected)[-1 - inside], wave.modes.incoming**inside
        assert found * away == pytest.approx(back / expected[-1], rel=1e-4)
        assert 1e-9 < abs(found) < 1


def test_a_frequency_is_a_wavelength():
    """Long waves on the lattice: omega = 2 D k^2, and at 45 degrees b^2 = omega cos / 2 D and a = b / cos, so that (a
    + i b)^2 = q^2 + i omega / D.
    """
    medium = LatticeMedium(fh.Stencil.finite_difference(2), 3.0, 0.5, Recursion(0.0, 1e-3, 1.0), 1e-3)
    wave = medium.diffusion_wave(2000.0, 45.0)
    number = 2 * np.pi / 2000.0
    assert wave.eigenvalue == pytest.approx(2j * 3.0 * (number / 0.5) ** 2, rel=1e-12)
    decay = -np.log(wave.modes.incoming)
    assert decay**2 == pytest.approx(wave.along[0] ** 2 + wave.eigenvalue / 12.0, rel=1e-5)
    assert decay.real > 0 and decay.imag == pytest.approx(wave.along[0], rel=1e-5)


def test_prediction_and_run_of_a_diffusive_layer():
    """The error against the infinite lattice, relative to the current maximum, is of the order of the prediction for
    the period of the run, and not above it.
    """
    half = 20.0
    for nodes in (8, 12):
        setup = {
            "lattice": fh.Lattice(1.0, (-half,), (half,)),
            "model": fh.Diffusion(fh.Kernel(2.0)),
            "boundary": fh.LatticePML(nodes=nodes),
            "initial": {"u": lambda x: np.exp(-(x**2) / 9)},
        }
        until = 10 * half**2
        report = fh.Simulation(**setup).check(until, budget=0.0)
        (found,) = report.reflections
        predicted = found.tables[2 * np.sqrt(np.pi * until)][0, 0]  # the diffusion wave whose period is the run
        error = next(iter(compare(setup, until, [until], beside=False).curves.values()))["error_rel_current"][-1]
        assert predicted / 10 < error < predicted
        assert "diffusion waves" in report.details


@pytest.mark.sampled(2)
@pytest.mark.parametrize("dim, reach, exponent", [(1, 3, 0), (2, 1, 2), (2, 3, 2), (2, 4, 1), (3, 2, 2)])
def test_reflection_is_what_the_half_infinite_problem_gives(dim, reach, exponent):
    """Amplitudes of the travelling modes, against the engine's own map with all evanescent modes."""
    profile = {"kappa": np.linspace(1, 3, 9), "sigma": 0.9 * np.linspace(0.05, 1, 9), "alpha": 0.02}
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 2,) * dim),
        fh.Wave(fh.Kernel(float(reach), exponent), damping=0.01),
        boundary=fh.LatticePML(nodes=8, profile=profile),
    )
    strip = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    layer = next(iter(sim.engine.layers.values()))
    for wavelength, angle in ((7.0, 0.0), (11.0, 40.0), (30.0, 70.0)):
        wave = strip.medium.plane_wave(wavelength, angle if dim > 1 else 0.0)
        found = np.linalg.norm(layer_amplitudes(wave, layer)[wave.modes.travels])
        assert found == pytest.approx(abs(strip.reflection(wavelength, angle if dim > 1 else 0.0)), rel=1e-6, abs=1e-13)


SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


@pytest.fixture
def random():
    print(f"seed {SEED}")
    return np.random.default_rng(SEED)


def complex_numbers(random, *shape):
    return random.normal(size=shape) + 1j * random.normal(size=shape)


def test_a_layer_without_stretch_continues_the_lattice():
    """Unstretched edges are transparent: continued by k nodes, the field of a column is that of the k-th column from
    it.
    """
    columns, reach = 5, 3
    near = 1 + np.arange(reach + 1)  # the nodes 0, -1 .. -reach
    field = 11.0 + np.arange(columns)  # the columns 1 .. L
    for k, (inwards, outwards) in enumerate(continuations(np.ones(columns + 1, complex), reach), 1):
        line = np.concatenate([near[:1], field, np.zeros(k)])
        np.testing.assert_array_equal(inwards @ line[: columns + 1], line[k : columns + 1 + k])
        line = np.concatenate([near[::-1], field])
        np.testing.assert_array_equal(
            outwards @ np.concatenate([field, near]), line[reach + 1 - k : reach + 1 - k + columns]
        )


def test_continued_fields_obey_the_recursion_over_each_edge(random):
    """``(1 - g) U(p+1, k+1) + (1 + g) U(p+1, k) = (1 + g) U(p, k+1) + (1 - g) U(p, k)``, inwards from k = 0, and
    outwards towards it.
    """
    columns, reach = 4, 3
    g = 2 + complex_numbers(random, columns + 1)
    matrices = list(continuations(g, reach))
    field, near = complex_numbers(random, columns + 1), complex_numbers(random, reach + 1)
    inside = np.array([field, *(inwards @ field for inwards, _ in matrices)])
    inside = np.pad(inside, ((0, 0), (0, 1)))  # nothing beyond the last column
    unknowns = np.concatenate([field[1:], near])
    outside = np.array([field[1:], *(outwards @ unknowns for _, outwards in matrices)])
    outside = np.concatenate([near[:, None], outside], axis=1)
    for p in range(columns + 1):
        for k in range(reach):
            u, v = inside[:, p], inside[:, p + 1]
            assert (1 - g[p]) * v[k + 1] + (1 + g[p]) * v[k] == pytest.approx(
                (1 + g[p]) * u[k + 1] + (1 - g[p]) * u[k], rel=1e-9, abs=1e-9
            )
            if p < columns:  # the same, k + 1 nodes outwards
                u, v = outside[:, p], outside[:, p + 1]
                assert (1 - g[p]) * v[k] + (1 + g[p]) * v[k + 1] == pytest.approx(
                    (1 + g[p]) * u[k] + (1 - g[p]) * u[k + 1], rel=1e-9, abs=1e-9
                )
