"""Spectra accumulated during a run: against the FFT of the record, and the exact frequency response of the lattice."""

import numpy as np
import pytest

import farhorizon as fh


def pulse(x, y):
    return np.exp(-4 * (x**2 + y**2))


def elastic(*observe):
    lattice = fh.Lattice(0.25, [-4.0, -4.0], [4.0, 4.0])
    material = fh.Elastic(fh.Kernel(0.5, exponent=1), 1.0)
    start = {"u": [lambda x, y: 0.01 * pulse(x, y), 0.0]}
    return fh.Simulation(lattice, material, fh.Sponge(4), start, observe=observe)


POINTS = [(0.13, 0.2), (-1.0, 0.5), (0.7, -0.41)]


@pytest.mark.parametrize("record", [["u"], ["u", "stress", "curl"]])
def test_as_the_fft_of_the_record(record):
    """At points between nodes and at all nodes of a region, for frequencies of the FFT that include the lowest and
    the highest that the lattice carries.
    """
    steps = 150
    receivers = fh.Receivers(POINTS, record)
    run = elastic(receivers)
    dt, most = run.dt, run.parts.near.highest_frequency
    numbers = np.array([0, 1, 9, int(most * steps * dt)])
    spectra = fh.Spectra(POINTS, numbers / (steps * dt), record)
    region = fh.Spectra(fh.Box((-0.3, -0.3), (0.3, 0.3)), numbers / (steps * dt), name="region")
    inside = fh.Receivers([(x, y) for x in (-0.25, 0.0, 0.25) for y in (-0.25, 0.0, 0.25)], name="inside")
    run = elastic(receivers, spectra, region, inside)
    for count in (1, 70, 0, 78):
        run.step(count)
    assert [*spectra.data] == record and [*region.data] == ["u"]
    for summed, recorded in ((spectra, receivers), (region, inside)):
        np.testing.assert_allclose(summed.points, recorded.points, atol=1e-14)
        for name, sums in summed.data.items():
            values = recorded.data[name]
            exact = dt * np.fft.fft(values, axis=0)[numbers]
            assert sums.shape == exact.shape
            np.testing.assert_allclose(sums, exact, rtol=0, atol=1e-12 * dt * np.abs(values).sum(0).max())


def test_response_of_the_line_in_frequency():
    """A chain with nearest neighbours, driven at a node: ``u_k = S h^2 z^|k| / (c^2 (1/z - z))``, z = exp(-i kappa),
    ``4 (c/h)^2 sin^2(kappa/2) = Omega^2``, ``Omega = 2/dt sin(omega dt/2)``, S the sum of the source.
    """
    h, c, f = 0.5, 2.0, np.array([0.1, 0.25, 0.5])
    lattice = fh.Lattice(h, -10.0, 10.0)

    def signal(t):  # a Ricker wavelet, which leaves the line at rest
        phase = (np.pi * 0.25 * (t - 6.4)) ** 2
        return (1 - 2 * phase) * np.exp(-phase)

    at_node = np.zeros(lattice.shape)
    at_node[20] = 1.0
    spectra = fh.Spectra([-3.0, 0.0, 2.5, 7.0], f)
    model = fh.Wave(fh.Stencil.finite_difference(1), speed=c)
    run = fh.Simulation(lattice, model, fh.Exact(), sources=[fh.Source(at_node, signal)], observe=[spectra])
    run.run(until=30.0)
    w = 2 * np.pi * f
    t = run.dt * np.arange(run.step_count + 1)
    s = run.dt * np.exp(-1j * np.outer(w, t)) @ signal(t)
    kappa = 2 * np.arcsin(h / c / run.dt * np.sin(w * run.dt / 2))
    z = np.exp(-1j * kappa)[:, None]
    nodes = np.abs(np.round(spectra.points[:, 0] / h))
    exact = s[:, None] * h**2 * z**nodes / (c**2 * (1 / z - z))
    # the signal begins at exp(-25) of its peak, the size of the slowest waves, which remain
    np.testing.assert_allclose(spectra.data["u"], exact, rtol=0, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("every", [2, 3])
def test_terms_of_every_few_steps(every):
    """For a pulse that comes and goes, the sums are those of all steps, in whatever batches it is run."""
    frequencies, points = [0.05, 0.2, 0.4], [(0.13, 0.2), (-1.0, 0.5)]
    all_steps, few = fh.Spectra(points, frequencies, name="all"), fh.Spectra(points, frequencies, every=every)
    inside = fh.Spectra(fh.Disc(0.6), frequencies, every=every, name="disc")
    lattice = fh.Lattice(0.25, [-4.0, -4.0], [4.0, 4.0])
    source = fh.PointSource((0.3, 0.1), time=fh.Ricker(0.35))
    runs = [
        fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), fh.LatticePML(nodes=10), sources=[source], observe=observe)
        for observe in ([all_steps, few], [inside])
    ]
    for run in runs:
        run.run(until=40.0)
    assert runs[0].engine.watch_stride == 1 and runs[1].engine.watch_stride == every
    largest = np.abs(all_steps.data["u"]).max()
    # what is left in the near field at the end, and the signal above the highest frequency
    np.testing.assert_allclose(few.data["u"], all_steps.data["u"], rtol=0, atol=1e-3 * largest)
    assert 0.2 * largest < np.abs(inside.data["u"]).max()
    alone = fh.Spectra(points, frequencies, every=every)
    again = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), fh.LatticePML(nodes=10), sources=[source], observe=[alone])
    for steps in (1, 70, 13, runs[0].step_count - 84):
        again.step(steps)
    np.testing.assert_array_equal(alone.data["u"], few.data["u"])


def test_saved_and_taken_up_the_sums_are_the_same_bit_by_bit(tmp_path):
    def made():
        return fh.Spectra(POINTS, [0.05, 0.2], ["u", "strain"])

    whole, first, second = made(), made(), made()
    elastic(whole).step(90)
    run = elastic(first)
    run.step(37)
    run.save(tmp_path / "state")
    fh.Simulation.restore(tmp_path / "state", observe=[second]).step(53)
    for name in whole.record:
        np.testing.assert_array_equal(second.data[name], whole.data[name])


@pytest.mark.parametrize(
    ("where", "frequencies", "options", "message"),
    [
        (POINTS, [0.1, 99.0], {}, "Nyquist"),
        (POINTS, "band", {}, "no wave on the lattice"),
        (POINTS, [-0.1], {}, "from 0 on"),
        (POINTS, [], {}, "from 0 on"),
        (POINTS, [0.1], {"record": "v"}, "linear"),
        (POINTS, [0.1], {"every": 5}, "alias waves"),
        (POINTS, [0.1], {"record": []}, "nothing is to be recorded"),
        ([(9.0, 0.0)], [0.1], {}, "outside"),
        (fh.Disc(0.1, (0.12, 0.12)), [0.1], {}, "no node"),
    ],
)
def test_refused(where, frequencies, options, message):
    """By the run at the latest."""
    run = elastic()
    assert run.parts.near.highest_frequency < 0.5 / run.dt
    if isinstance(frequencies, str):
        frequencies = [1.01 * run.parts.near.highest_frequency]
    with pytest.raises(fh.InputError, match=message):
        elastic(fh.Spectra(where, frequencies, **options))


def test_a_plane_is_its_layer_of_nodes():
    """A plane stands for the nodes nearest to it, as a thin region does."""
    lattice, model = fh.Lattice(0.5, (-4.0, -3.0), (4.0, 3.0)), fh.Wave(fh.Kernel(1.0))
    plane = fh.Spectra(("y", 1.1), [0.1], name="plane")
    thin = fh.Spectra(fh.Box((-4.0, 0.9), (4.0, 1.1)), [0.1], name="thin")
    sim = fh.Simulation(lattice, model, fh.Fixed(), {"u": "exp(-x**2 - y**2)"}, observe=[plane, thin])
    sim.step(9)
    np.testing.assert_array_equal(plane.points, [(x, 1.0) for x in np.linspace(-4, 4, 17)])
    np.testing.assert_array_equal(plane.data["u"], thin.data["u"])
    for where, words in ((("y", 9.0), "no node .* limit: .* remedy"), (("z", 0.0), "no such axis")):
        with pytest.raises(fh.InputError, match=words):
            fh.Simulation(lattice, model, observe=[fh.Spectra(where, [0.1])])


def test_no_run_has_no_spectra():
    with pytest.raises(fh.InputError, match=r"spectra: the spectra of no run; .*observe=\[spectra\]"):
        _ = fh.Spectra([0.0], [0.1]).data
