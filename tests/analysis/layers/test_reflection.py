"""Reflection of plane waves: the exact half-infinite problem against closed forms, energy, and time-domain runs."""

import numpy as np
import pytest
from scipy import optimize

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.reflection import Chain, chain_weights, factor_of_wave
from farhorizon.checks.side_modes import Strip
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
        modes = Chain.of(weights, factor, recursion).modes(np.exp(0.5j))
        assert modes.incoming == pytest.approx(np.exp(0.5j)) and len(modes.leaving) == 3
        powers = np.arange(-3, 4)
        for zeta in (modes.incoming, *modes.leaving):
            assert (weights * zeta**powers).sum() == pytest.approx(recursion.eigenvalue(np.array(factor)), abs=1e-10)
        grown = Chain.of(weights, factor * (1 + 1e-4), recursion).modes(np.exp(0.5j))
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
    modes = Chain.of(chain_weights(stencil, []), factor, recursion).modes(np.exp(1j * number))
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
        chain = Chain.of(chain_weights(stencil, [along, 0.0]), factor, recursion)
        modes = chain.modes(np.exp(1j * number * detuned), vector)
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
