"""The far field of a box: receivers outside it, patterns, cross sections and energies, against larger runs, the
infinite lattice and the optical theorem.
"""

import copy
import pickle
import re
import warnings

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.radiation import squared_frequency, waves_sent
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice, Scheme
from farhorizon.simulation.recorders import far_field

_SCALAR = fh.Kernel(horizon=2.0)
_BONDS = {"kernel": fh.Kernel(horizon=2.0, influence="linear", exponent=1), "young": 2.0, "density": 0.5}
# A burst of width 12, cut off where it is 1e-11, which is also the leakage found in `tests/inputs/test_plane_waves.py`.
_SIGNAL, _DURATION, _EXACT = fh.Expression("sin(2*pi*t/16)*exp(-((t-60)/12)**2)", 0), 120.0, 1e-11


def _square(half, dim=2):
    return fh.Lattice(spacing=1.0, lower=(-half,) * dim, upper=(half,) * dim)


def _box(half, dim=2, shift=0):
    return fh.Box((-half + shift,) * dim, (half + shift,) * dim)


def _pulse(dim, components):
    """A pulse off the centre that has fallen to 1e-17 at a distance of 8, in 3D of 5."""
    text = "exp(-((x-0.5)**2 + (y+0.7)**2" + (" + z**2)/0.5)" if dim == 3 else ")/1.6)")
    return text if components == 1 else [text, f"-0.6*{text}", "0"][:components]


@pytest.mark.parametrize(
    ("model", "box"),
    [
        (fh.Wave(_SCALAR), 8),
        (fh.Wave(_SCALAR, damping=0.05), 8),
        (fh.Elastic(**_BONDS), 8),
        (fh.Diffusion(_SCALAR, integrator="euler"), 8),
        (fh.Diffusion(_SCALAR, integrator="rk4"), 15),  # four times the reach
        (fh.Diffusion(_SCALAR, integrator=fh.RungeKuttaChebyshev(3)), 13),
    ],
    ids=lambda one: f"{type(one).__name__}, {one.integrator.name}, {one.damping}" if hasattr(one, "damping") else "",
)
def test_receivers_are_what_a_larger_run_with_a_crack_sees(model, box):
    """Both runs have sides from which nothing returns, so that only the far field is tested."""
    points = [(box + 11, 0), (-box - 9, 16), (box + 3, -13)]

    def made(half, *observe):
        crack = [[(-2.5, -1.2), (2.5, 1.5)]]
        initial = {"u": _pulse(2, 2 if model.mechanical else 1)}
        return fh.Simulation(_square(half), model, fh.Extended(nodes=40), initial, cracks=crack, observe=observe)

    far = fh.FarField(_box(box))
    near, large = made(box + 8, far), made(box + 16)
    probes = large.record(points)
    for sim in (near, large):
        sim.run(40.0)
    times, values = far.at(points)
    np.testing.assert_allclose(times, probes.times, rtol=1e-14)
    size = np.abs(probes.values).max(axis=(0, *range(2, values.ndim)))
    assert (size > 1e-6).all()
    error = np.abs(values - probes.values).max(axis=(0, *range(2, values.ndim)))
    assert (error < 1e-10 * size).all()


@pytest.mark.parametrize(
    "model",
    [fh.Wave(fh.Kernel(1.0)), fh.Elastic(fh.Kernel(1.5, 1, "linear"), 2.0, density=2.5)],
    ids=["scalar", "elastic"],
)
def test_receivers_in_space_are_on_the_infinite_lattice(model):
    far, pulse = fh.FarField(), {"u": _pulse(3, 3 if model.mechanical else 1)}
    sim = fh.Simulation(_square(7, 3), model, fh.Extended(nodes=13), pulse, dt=0.5, observe=[far])
    sim.run(15.0)
    points = np.array([(9, 0, 0), (-7, 6, 8), (4, -9, 3)])
    values = far.at(points)[1]
    wide = np.zeros((*sim.field_shape[:-3], 19, 19, 19))
    wide[..., 2:-2, 2:-2, 2:-2] = sim.start_u
    exact = InfiniteLattice(sim.stencil, sim.model.coefficient, sim.model.integrator, sim.dt, sim.step_count, wide)
    peak = np.abs(values).max()
    assert peak > 1e-3
    for step in (2 * sim.step_count // 3, sim.step_count):
        seen = exact.after(step)[(..., *(points + 9).T)].T
        assert np.abs(values[step] - seen).max() < 1e-10 * peak


@pytest.mark.parametrize(
    "model",
    [
        fh.Wave(_SCALAR, speed=3.0, damping=0.03),
        fh.Elastic(**_BONDS),
        fh.Elastic(_SCALAR, young=1.0, poisson=0.1, material="state-based"),
    ],
    ids=["scalar", "bond-based", "state-based"],
)
def test_records_that_end_before_the_waves_arrive_say_so(model):
    """Continued beyond the run, they are those of the infinite lattice. The tail that precedes the front of what the
    run does not know is below 1e-2, and below 1e-4 a box width earlier.
    """
    far, pulse, point = fh.FarField(_box(8)), {"u": _pulse(2, 2 if model.mechanical else 1)}, (48, 36)
    slow, fast = min(model.speeds.values()), max(model.speeds.values())
    sim = fh.Simulation(_square(13), model, fh.Extended(nodes=60), pulse, observe=[far])
    sim.run(26.0 / slow)
    with pytest.warns(fh.ValidityWarning, match=r"the far field at \[48, 36\] ends at t = ") as said:
        early = far.at([point])[1]
    with pytest.warns(fh.ValidityWarning, match="is nan after it"):
        times, values = far.at([point], until=80.0 / slow)
    padded = np.pad(sim.start_u, [(0, 0)] * (sim.start_u.ndim - 2) + [(60, 60)] * 2)
    scheme = sim.stencil, sim.model.coefficient, sim.model.integrator, sim.dt, len(times), padded
    infinite = InfiniteLattice(*scheme, damping=model.damping)
    exact = np.array([infinite.after(step)[..., 73 + point[0], 73 + point[1]] for step in range(len(times))])
    sizes, errors = (np.abs(one).reshape(len(times), -1).max(1) for one in (exact, values[:, 0] - exact))
    assert np.abs(early).max() < 0.05 * sizes.max()
    arrival = float(re.search(r"at about t = (\S+),", str(said[0].message))[1])
    assert arrival == pytest.approx(times[sizes.argmax()], rel=0.1)
    known = np.isfinite(errors)
    assert times[known][-1] > sim.time + 30 / fast and not known.all()  # the box is 45 away
    assert errors[known].max() < 1e-2 * sizes.max()
    assert errors[times < times[known][-1] - 17 / fast].max() < 1e-4 * sizes.max()


@pytest.mark.parametrize("model", [fh.Wave(_SCALAR), fh.Elastic(**_BONDS), fh.Diffusion(_SCALAR)])
def test_records_that_have_the_largest_waves_say_nothing(model, recwarn):
    far, pulse = fh.FarField(_box(10)), "exp(-(x**2 + y**2)/4)"
    until = 80.0 if model.order == 1 else 20.0 / min(model.speeds.values())  # r^2 / (4 D) = 64 and r / c = 16
    initial = {"u": [pulse, "0"] if model.mechanical else pulse}
    fh.Simulation(_square(14), model, fh.LatticePML(nodes=8), initial, observe=[far]).run(until)
    far.at([(16, 0), (-11, -11)])
    assert not [one for one in recwarn if "far field" in str(one.message)]


def test_boxes_in_each_other_and_moved_tell_the_same():
    boxes = (_box(8), _box(12), _box(8, shift=1), fh.Box((-9, -8), (15, 13)))
    fars = [fh.FarField(box, name=f"box-{number}") for number, box in enumerate(boxes)]
    fh.Simulation(_square(17), fh.Elastic(**_BONDS), fh.Extended(nodes=40), {"u": _pulse(2, 2)}, observe=fars).run(40.0)
    values = [far.at([(30, 7), (-20, -20)])[1] for far in fars]
    for one in values[1:]:
        np.testing.assert_allclose(one, values[0], atol=1e-13 * np.abs(values[0]).max())


@pytest.mark.parametrize(
    ("model", "polarisation", "box"),
    [(fh.Wave(_SCALAR), "P", None), (fh.Elastic(**_BONDS), "S", _box(6))],
    ids=["around the wave's box", "inside it"],
)
def test_an_incident_wave_alone_radiates_nothing(model, polarisation, box):
    wave = fh.IncidentWave((1.0, 0.3), _SIGNAL, _DURATION, polarisation)
    far, given = fh.FarField(box), {"sources": [wave], "dt": lambda half: 1.8 * half}
    fh.Simulation(_square(14), model, fh.LatticePML(nodes=6), observe=[far], **given).run(130.0)
    assert np.abs(far.at([(25, 0), (-30, 10), (22, -28)])[1]).max() < _EXACT


def test_a_box_at_the_edge_of_a_window_is_refused():
    lattice = fh.Lattice(1.0, window=fh.Disc(14.0))
    with pytest.raises(fh.InputError, match="edge of the window"):
        fh.Simulation(lattice, fh.Wave(_SCALAR), observe=[fh.FarField(_box(11))])


def _refused(match, half=6, box=None, **changes):
    with pytest.raises(fh.InputError, match=match):
        fh.Simulation(_square(14), fh.Wave(_SCALAR), observe=[fh.FarField(box or _box(half))], **changes)


def test_boxes_that_do_not_serve():
    _refused("leave one reach of the near field", 13)
    _refused("so small that nothing lies one reach inside", 1)
    _refused("differ in dimension", box=fh.Box(-3.0, 3.0))
    _refused("cuts a crack", cracks=[[(0.3, 0.2), (9.3, 0.2)]])
    _refused("cuts a crack", cracks=[[(4.3, 0.2), (6.3, 0.2)]])
    _refused("another material", coefficient=lambda x, y: np.where(x > 8, 0.5, 1.0))
    _refused("another material", coefficient=lambda x, y: np.where(abs(x) + abs(y) < 6, 0.5, 1.0))
    _refused(
        "without end: .*value: y-.*remedy: LatticePML there; or",
        boundary={"y-": fh.Free(), "all": fh.LatticePML(nodes=8)},
    )
    _refused("not zero outside the box", sources=["exp(-((x-7)**2+y**2))*sin(t)"])
    _refused("not zero outside the box", initial={"u": "exp(-(x**2+y**2)/6)"})
    _refused("meets the box of an incident wave", sources=[fh.IncidentWave((1, 0), _SIGNAL, _DURATION)], half=11)
    _refused("leaves out nodes that a condition holds", constraints=[fh.Prescribed([[8.0, 0.0]], 0.0)])


def test_a_far_field_that_is_asked_for_what_it_does_not_have():
    far = fh.FarField(history=False, frequencies=[0.1])
    with pytest.raises(fh.InputError, match="of no run"):
        far.pattern()
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), initial={"u": _pulse(2, 1)}, observe=[far])
    sim.step(3)
    with pytest.raises(fh.InputError, match=r"far_field\.history: .*remedy: history = true"):
        far.at([(20.0, 0.0)])
    with pytest.raises(fh.InputError, match="cross sections are those of one incident wave"):
        far.cross_sections()
    for nothing in ({}, {"frequencies": [0.1], "points": [(20.0, 0.0)]}):
        with pytest.raises(fh.InputError, match="frequencies without points"):
            fh.FarField(history=False, **nothing)


def test_receivers_are_outside_the_box_at_nodes():
    far = fh.FarField(_box(10))
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), initial={"u": _pulse(2, 1)}, observe=[far])
    sim.step(3)
    with pytest.raises(fh.InputError, match="inside the box"):
        far.at([(3.0, 0.0)])
    with pytest.raises(fh.InputError, match="distances that can be computed"):
        far.at([(1e30, 0.0)])
    with pytest.raises(fh.InputError, match=r"far_field\.frequencies: no frequencies"):
        far.pattern()
    with pytest.warns(fh.ValidityWarning, match="ends at t = "):
        far.at([(20.3, 0.0)])
    assert far.notes[:-1] == ["the far field at [20.3, 0] is that of the nearest node, [20, 0]"]


def test_sources_that_move_out_of_the_box_are_refused():
    moving = {"sources": ["exp(-2*((x-t)**2 + y**2))"]}
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), observe=[fh.FarField(_box(8))], **moving)
    with pytest.raises(fh.InputError, match="not zero outside the box of a far field"):
        sim.prepare(12.0)


def test_names_that_results_would_have_twice_are_refused():
    recorders = [fh.FarField(), fh.Receivers([(0.0, 0.0)], name="far_field_points")]
    with pytest.raises(fh.InputError, match="two recorders have one name; value: far_field_points"):
        fh.Simulation(_square(14), fh.Wave(_SCALAR), observe=recorders)


def test_a_run_tells_its_far_fields():
    fars = [fh.FarField(name="one"), fh.FarField(_box(8), name="two")]
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), observe=[fh.Receivers([(0.0, 0.0)]), *fars])
    assert sim.far_field("two") is fars[1]
    with pytest.raises(
        fh.InputError, match=r"name: the run records several .*\[one, two\]; limit: 1; remedy: name one"
    ):
        sim.far_field()
    with pytest.raises(fh.InputError, match=r"no such far field; value: .*three.*; limit: one, two"):
        sim.far_field("three")
    alone = fh.Simulation(_square(14), fh.Wave(_SCALAR), observe=fars[:1])
    assert alone.far_field() is fars[0]
    with pytest.raises(fh.InputError, match=r"far_field: the run records no .*remedy: observe=\[FarField\(\)\], or"):
        fh.Simulation(_square(14), fh.Wave(_SCALAR)).far_field()


def test_copies_have_what_was_recorded():
    """Copies of the run, and of the far field alone."""
    wave = fh.IncidentWave((1.0, 0.0), "sin(t/3)*exp(-((t-30)/6)**2)", 60.0)
    far = fh.FarField(frequencies=[0.05])
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), fh.LatticePML(nodes=6), sources=[wave], observe=[far])
    sim.run(5.0)
    again = pickle.loads(pickle.dumps(sim))
    for run in (sim, again):
        run.run(20.0)
    for other in (again.recorders[0], copy.deepcopy(far)):
        assert other is not far
        np.testing.assert_array_equal(other.at([(20, 0)])[1], far.at([(20, 0)])[1])
        np.testing.assert_array_equal(other.cross_sections().total, far.cross_sections().total)


def test_a_run_that_is_saved_goes_on_with_its_far_field(tmp_path):
    far, again = (fh.FarField(_box(10), [0.05]) for _ in range(2))
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), initial={"u": _pulse(2, 1)}, observe=[far])
    sim.run(5.0)
    sim.save(tmp_path / "run.ckpt")
    for run in (sim, fh.Simulation.restore(tmp_path / "run.ckpt", observe=[again])):
        run.run(20.0)
    np.testing.assert_array_equal(again.at([(17, 3)])[1], far.at([(17, 3)])[1])
    np.testing.assert_array_equal(again.pattern(8).amplitudes, far.pattern(8).amplitudes)
    with pytest.raises(fh.InputError, match="from the start of a run on"):
        fh.Simulation.restore(tmp_path / "run.ckpt", observe=[fh.FarField(name="other")])


def _burst(t, frequency=0.08, width=7.6):
    """Burst that begins and ends at 1e-12, without a mean value, which 2D would remember."""
    late = t - 5.26 * width
    return np.sin(2 * np.pi * frequency * late) * np.exp(-((late / width) ** 2))


@pytest.mark.parametrize(
    ("model", "half", "dt", "width", "layers"),
    [
        (fh.Wave(fh.Kernel(1.0)), 7, 0.5, 7.6, 14),
        # a longer burst, since short S waves leave slowly; what the layers reflect enters the energy to first order
        pytest.param(
            fh.Elastic(fh.Kernel(1.5, 1, "linear"), 2.0, density=2.5), 8, 0.9, 14.0, 20, marks=pytest.mark.slow
        ),
    ],
    ids=["scalar", "elastic"],
)
def test_the_pattern_of_a_box_is_that_of_the_sources_in_it(model, half, dt, width, layers):
    """In 3D, the pattern from the forces on the shell around the box equals that of the sources themselves on the
    wave surface; its intensities over all directions sum to the energy that leaves the box.
    """
    frequencies, components = [0.06, 0.08], 3 if model.mechanical else 1
    space = np.zeros((components, *(2 * half + 1,) * 3))
    random = np.random.default_rng(20261123)
    places = half + random.integers(-1, 2, (3, 3))
    space[:, *places.T] = random.normal(size=(components, 3))
    far = fh.FarField(frequencies=frequencies, history=False)
    source = fh.Source(space if components > 1 else space[0], lambda t: _burst(t, 0.07, width))
    box = _square(half, 3)
    sim = fh.Simulation(box, model, fh.LatticePML(nodes=layers), sources=[source], observe=[far], dt=dt)
    sim.run(16 * width)
    heights, weights = np.polynomial.legendre.leggauss(12)
    turns = 2 * np.pi * np.arange(24) / 24
    z, turn = (each.ravel() for each in np.meshgrid(heights, turns, indexing="ij"))
    directions = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1)
    directions = directions @ np.linalg.qr(random.normal(size=(3, 3)))[0]  # off the planes where both S waves coincide
    pattern = far.pattern(directions)
    times = dt * np.arange(sim.step_count)
    nodes = np.argwhere(space.any(0))
    scheme = Scheme.of(sim.stencil, sim.model.coefficient, sim.model.integrator, dt)
    for number, frequency in enumerate(frequencies):
        amplitude = dt * np.exp(2j * np.pi * frequency * times) @ _burst(times, 0.07, width) * sim.model.source_factor
        forces = amplitude * space[:, *nodes.T]
        own, shapes, *_ = waves_sent(scheme, squared_frequency(scheme, frequency), nodes - half, forces, directions)
        found = (pattern.amplitudes[number][..., None] * pattern.polarisations[number]).conj()
        wrong = found - own[..., None] * shapes
        # where both S waves coincide, their polarisations are arbitrary
        assert max(np.abs(wrong[0]).max(), np.abs(wrong[1:].sum(0)).max(initial=0)) < 1e-6 * np.abs(own).max()
    around, energies = np.repeat(weights * 2 * np.pi / 24, 24), far.energies()
    np.testing.assert_allclose(sum(energies.values()), far.energy(), rtol=1e-6)
    fastest = (pattern.intensities[:, 0] * around).sum(1)  # several S waves may share a direction
    np.testing.assert_allclose(fastest, energies["P" if model.mechanical else "wave"], rtol=1e-6)


@pytest.mark.slow
def test_patterns_are_the_field_far_away():
    """The spectra of the field that a crack scatters approach the pattern with an error of order 1/r."""
    wave, errors, radii = fh.IncidentWave((1.0, 0.3), _SIGNAL, _DURATION), [], (20, 40, 80)
    far = fh.FarField(_box(6), [0.05, 0.0625, 0.08])
    sim = fh.Simulation(
        _square(14),
        fh.Wave(_SCALAR),
        fh.LatticePML(nodes=24),
        sources=[wave],
        cracks=[[(-1.5, -3.2), (1.5, 3.5)]],
        observe=[far],
        dt=lambda half: 1.8 * half,
    )
    sim.run(300.0)
    for r in radii:
        times, u = far.at([(0.6 * r, 0.8 * r), (-0.8 * r, 0.6 * r)])
        spectra = sim.dt * np.exp(-2j * np.pi * np.outer(far.frequencies, times)) @ u
        pattern = far.pattern([(0.6, 0.8), (-0.8, 0.6)]).spectrum(r)
        errors.append(np.abs(spectra - pattern).max() / np.abs(spectra).max())
    assert errors[-1] < 0.05 and -np.polyfit(np.log(radii), np.log(errors), 1)[0] > 0.8, errors


@pytest.mark.parametrize(
    ("model", "polarisation"), [(fh.Wave(_SCALAR), "P"), (fh.Elastic(**_BONDS), "S")], ids=["scalar", "S"]
)
def test_a_crack_scatters_what_the_incident_wave_loses(model, polarisation):
    """The optical theorem holds, and the energy through the box equals that of the pattern over all directions; for a
    box around that of the incident wave, and for boxes inside it.
    """
    wave = fh.IncidentWave((1.0, 0.3), _SIGNAL, _DURATION, polarisation)
    boxes = {"around": None, "inside": _box(6), "moved": fh.Box((-6, -6), (5, 6))}
    fars = [fh.FarField(box, [0.05, 0.0625, 0.08], history=False, name=name) for name, box in boxes.items()]
    sim = fh.Simulation(
        _square(14),
        model,
        fh.LatticePML(nodes=24),
        sources=[wave],
        cracks=[[(-1.5, -3.2), (1.5, 3.5)]],
        observe=fars,
        dt=lambda half: 1.8 * half,
    )
    sim.run(400.0)
    around = fars[0].pattern(96)
    for far in fars:
        scattering, total = far.cross_sections()
        assert (scattering > 5).all() and not far.notes
        np.testing.assert_allclose(scattering, total, rtol=1e-7)
        pattern = far.pattern(96)
        for energies, intensities in zip(far.energies().values(), pattern.intensities.swapaxes(0, 1), strict=True):
            np.testing.assert_allclose(intensities.sum(-1) * 2 * np.pi / 96, energies, rtol=1e-6)
        np.testing.assert_allclose(pattern.cross_sections.sum((1, 2)) * 2 * np.pi / 96, scattering, rtol=1e-6)
        size = np.abs(around.amplitudes).max()
        np.testing.assert_allclose(pattern.amplitudes, around.amplitudes, atol=1e-7 * size)


@pytest.mark.parametrize(
    ("frequencies", "model", "words"),
    [
        ([0.9], fh.Wave(_SCALAR), r"does not carry .*value: 0.9; limit: 0 to 0\.\d+ cycles per time"),
        ([-0.1], fh.Wave(_SCALAR), "does not carry .*remedy: a higher frequency"),
        ([0.1], fh.Diffusion(_SCALAR), "only waves have a pattern by frequency"),
        ([[0.1]], fh.Wave(_SCALAR), "has another shape"),
    ],
)
def test_frequencies_that_do_not_serve(frequencies, model, words):
    with pytest.raises(fh.InputError, match=rf"far_field\.frequencies: .*{words}"):
        fh.Simulation(_square(14), model, observe=[fh.FarField(frequencies=frequencies)])


@pytest.mark.parametrize(("fast", "told"), [(0.0, False), (1.0, True)])
def test_what_is_faster_than_the_lattice_is_told(fast, told, monkeypatch):
    """Near a source that oscillates faster than any wave of the lattice: the error that the warning states is of the
    order of the difference to spectra that use every step.
    """

    def run():
        far = fh.FarField(_box(8), [0.05, 0.0625])
        burst = fh.Expression(f"(sin(2*pi*t/16) + {fast}*sin(2*pi*t*0.36))*exp(-((t-60)/12)**2)", 0)
        source = fh.PointSource((5.0, 0.0), time=burst)
        sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), fh.LatticePML(nodes=16), sources=[source], observe=[far])
        assert sim.parts.near.highest_frequency < 0.3
        sim.run(1000.0)
        return far, sim

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        far, sim = run()
    assert bool(caught) == bool(far.notes) == told and far.notes == sim.notes
    monkeypatch.setattr(far_field, "steps_between_samples", lambda *_: 1)
    every, _ = run()
    assert not every.notes
    one, other = far.pattern(16).amplitudes, every.pattern(16).amplitudes
    error = np.abs(one - other).max() / np.abs(other).max()
    if told:
        assert "faster than all waves" in far.notes[0] and "ValidityWarning" in str(caught[0].category)
        assert caught[0].filename == __file__
        said = float(re.search(r"some ([-.0-9e]+) of", far.notes[0])[1])
        assert error / 10 < said < 10 * error and error > 1e-4
    else:
        assert error < 1e-4


def test_a_run_that_ends_too_soon_is_told_at_its_end():
    """At the end of the run, not only when spectra are requested, and not while it goes on."""
    far = fh.FarField(frequencies=[0.08])
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR), initial={"u": _pulse(2, 1)}, observe=[far])
    sim.step(3)
    assert not sim.notes
    with pytest.warns(fh.ValidityWarning, match="leave out") as caught:
        sim.run(10.0)
    assert caught[0].filename == __file__ and sim.notes == far.notes == [str(caught[0].message)]


def test_damping_takes_what_is_radiated():
    far = fh.FarField(frequencies=[0.08])
    sim = fh.Simulation(_square(14), fh.Wave(_SCALAR, damping=0.1), initial={"u": _pulse(2, 1)}, observe=[far])
    sim.step(5)
    with pytest.raises(fh.InputError, match="damping absorbs"):
        far.energy()
    assert far.pattern([(1.0, 1.0)]).spectrum(10.0).shape == (1, 1)
    (note,) = far.notes
    assert note.startswith("spectra of the far field leave out what has not left the box")
