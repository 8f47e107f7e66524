"""Signals: their spectra against numerical quadrature, their highest frequencies, and what is refused."""

import os

import numpy as np
import pytest
from scipy import optimize, special

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.simulation.time.source_terms import signals

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
RNG = np.random.default_rng(SEED)
ROUGH = np.cumsum(RNG.standard_normal(30)) * np.linspace(0, 1, 30) ** 3


SIGNALS = {
    "ricker": fh.Ricker(RNG.uniform(0.5, 2.0)),
    "late ricker": fh.Ricker(1.0, delay=4.0),
    "gaussian": fh.Gaussian(RNG.uniform(0.5, 2.0)),
    "burst": fh.ToneBurst(RNG.uniform(0.5, 2.0), RNG.uniform(1.0, 8.0)),
    "one cycle": fh.ToneBurst(3.0, 1),
    "step": fh.Step(RNG.uniform(0.5, 2.0)),
    "chirp": fh.Chirp(0.7, 3.1, RNG.uniform(4.0, 9.0)),
    "falling chirp": fh.Chirp(4.0, 1.0, 6.0),
    "samples": fh.Samples(np.append(ROUGH, 0.0), 0.2),
    "samples of a load that lasts": fh.Samples(ROUGH, 0.3),
}


@pytest.fixture(autouse=True)
def _seed():
    print(f"seed {SEED}")


EVERY = pytest.mark.parametrize("signal", SIGNALS.values(), ids=SIGNALS)


def pieces(signal):
    """Return nodes and weights of Gauss's rule on intervals in which the signal is smooth, and where they end: a
    spline extends a little before its first sample and beyond its last.
    """
    more = 20 if isinstance(signal, fh.Samples) else 0
    count = len(signal.values) - 1 + 2 * more if more else 200
    width = signal.dt if more else signal.end / count
    points, weights = np.polynomial.legendre.leggauss(12)
    nodes = width * (np.arange(count)[:, None] - more + 0.5 + points / 2)
    return nodes.ravel(), np.tile(width / 2 * weights, count), width * (count - more)


@EVERY
def test_spectrum_is_that_of_quadrature(signal):
    """A value that remains after the end contributes the spectrum of a jump there."""
    nodes, weights, end = pieces(signal)
    frequencies = signal.median_frequency * np.array([0.03, 0.4, 1.0, 1.7, 2.9])
    turns = np.exp(-2j * np.pi * np.outer(frequencies, nodes))
    known = turns @ (weights * signal(nodes))
    known += float(signal(100 * end)) * np.exp(-2j * np.pi * frequencies * end) / (2j * np.pi * frequencies)
    # pulses that are nowhere zero begin and end with 1e-8 of their peak
    assert np.abs(signal.spectrum(frequencies) - known).max() < 1e-7 * np.abs(known).max()
    assert signal.spectrum(frequencies[0]).shape == ()


@EVERY
def test_above_the_highest_frequency_lies_less_than_a_thousandth(signal):
    """The part of the signal above this frequency, synthesised from its spectrum, is nowhere larger; slightly below
    it the bound no longer holds.
    """
    highest, width = signal.highest_frequency, 1 / (16 * signal.end)
    above = highest + width * (np.arange(200_000) + 0.5)
    above = above[above < 60 * highest]
    spectrum = signal.spectrum(above)
    times = np.linspace(0.0, signal.end, 50)
    rest = [2 * width * (spectrum * np.exp(2j * np.pi * above * t)).sum().real for t in times]
    peak = np.abs(signal(np.linspace(0.0, signal.end, 5000))).max()
    assert np.abs(rest).max() < 1e-3 * peak
    bound = 2 * width * np.abs(spectrum).sum() / peak
    assert bound < 1.05e-3
    lower = np.linspace(0.8 * highest, highest, 400)
    assert bound + 2 * np.abs(signal.spectrum(lower)).mean() * 0.2 * highest / peak > 1e-3


def test_highest_frequencies_that_are_known():
    """For the Ricker wavelet and the Gaussian pulse the integral of the spectrum is an incomplete gamma function."""
    ricker = optimize.brentq(lambda x: special.gammaincc(1.5, x**2) - 1e-3, 1.0, 5.0)
    gauss = optimize.brentq(lambda x: special.erfc(x) - 1e-3, 1.0, 5.0) / np.pi
    # to the resolution of the spectra, 1/8 of that of a signal of this length
    assert fh.Ricker(3.0).highest_frequency == pytest.approx(3 * ricker, rel=0.02)
    assert fh.Gaussian(0.2).highest_frequency == pytest.approx(gauss / 0.2, rel=0.02)
    assert fh.ToneBurst(5.0, 10).median_frequency == pytest.approx(5.0, rel=0.02)


def test_units_of_time_do_not_matter():
    for scale in (1e-9, 1e12):
        assert fh.Ricker(2.0 / scale).highest_frequency * scale == pytest.approx(fh.Ricker(2.0).highest_frequency)
        samples = fh.Samples(1e-20 * ROUGH, 0.1 * scale)
        assert samples.highest_frequency * scale == pytest.approx(fh.Samples(ROUGH, 0.1).highest_frequency)


def test_a_spectrum_that_does_not_end():
    """A jump has an amplitude at every frequency."""

    class Jumps(fh.Signal):
        end = 1.0

        def __call__(self, t):
            return np.where((np.asarray(t) > 0) & (np.asarray(t) < 1), 1.0, 0.0)

        def spectrum(self, frequency):
            return np.sinc(frequency) * np.exp(-1j * np.pi * np.asarray(frequency))

    del fh.Signal.known["Jumps"]
    assert Jumps().highest_frequency == np.inf


def test_all_begin_at_rest():
    for signal in SIGNALS.values():
        assert abs(float(signal(0.0))) < 1e-3
        assert float(signal(3 * signal.end)) == pytest.approx(float(signal(signal.end)), abs=1e-7)
    for make in (lambda: fh.Ricker(1.0, delay=0.5), lambda: fh.Gaussian(1.0, delay=1.0)):
        with pytest.raises(
            fh.InputError, match=r"delay: the signal does not begin at rest.*limit: 0.001; remedy: delay = "
        ):
            make()


class TestSamples:
    def test_they_are_joined(self):
        """The interpolant passes through every sample; between them the error of a smooth signal falls with the
        fourth power of dt.
        """
        errors = []
        for count in (20, 40, 80):
            times = np.linspace(0.0, 10.0, count + 1)
            known = fh.ToneBurst(0.3, 3)
            found = fh.Samples(known(times), times[1])
            assert np.abs(found(times) - known(times)).max() < 1e-14
            between = np.linspace(0.0, 10.0, 1001)
            errors.append(np.abs(found(between) - known(between)).max())
        rate = np.polyfit(np.log([20, 40, 80]), np.log(errors), 1)[0]
        assert rate < -3.7, errors

    @pytest.mark.parametrize("name", ["signal.npy", "values.txt", "times.csv"])
    def test_they_are_read(self, tmp_path, name):
        values, path = np.sin(np.linspace(0, np.pi, 21)) ** 2, tmp_path / name
        if name == "signal.npy":
            np.save(path, values)
        elif name == "values.txt":
            np.savetxt(path, values)
        else:
            np.savetxt(path, np.column_stack([0.5 * np.arange(21), values]), delimiter=", ")
        for given in (path, str(path)):
            found = fh.Samples(given, 0.5)
            np.testing.assert_allclose(found.values, values, rtol=1e-15)
            assert found.end == 10.0

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ([0.0, 1.0, 0.0], r"samples.values: .* list of samples; value: shape \(3,\); limit: at least 4"),
            (np.ones((5, 3)), "one list of samples"),
            (np.zeros(9), "all samples are zero"),
            ([0.0, 1.0, np.nan, 0.0], "must be finite"),
            ([0.5, 1.0, 2.0, 0.0], r"does not begin at rest.*value: 0.25 of the largest sample"),
            ("no such file", "cannot read the samples"),
            ("x" * 300, "cannot read the samples .*no such file"),
        ],
    )
    def test_what_is_no_signal(self, values, message):
        with pytest.raises(fh.InputError, match=message):
            fh.Samples(values, 1.0)

    def test_times_in_another_unit(self, tmp_path):
        """Milliseconds in the file, seconds in the run."""
        path = tmp_path / "times.txt"
        np.savetxt(path, np.column_stack([2.0 * np.arange(9), np.sin(np.arange(9)) ** 2]))
        with pytest.raises(
            fh.InputError, match=r"samples.dt: .*9 from 0 on, 2 apart; limit: .* dt = 0.002; remedy: dt = 2"
        ):
            fh.Samples(path, 0.002)

    def test_a_file_of_something_else(self, tmp_path):
        path = tmp_path / "text.txt"
        path.write_text("a signal\n")
        with pytest.raises(fh.FileFormatError, match=r"cannot read the samples .*text\.txt: it is damaged"):
            fh.Samples(path, 1.0)


# In set-ups

LINE = fh.Lattice(0.05, -1.0, 1.0)
MODEL = fh.Wave(fh.Stencil.finite_difference(1))
CASE = """
lattice = { spacing = 1.0, lower = [-12.0], upper = [12.0] }
model = { type = "wave", stencil = "finite-difference" }
boundary = { all = { type = "exact" } }
run = { until = 20.0 }
[[source]]
value = "exp(-x**2)"
"""


@EVERY
def test_a_signal_drives_as_a_function_does(signal, tmp_path):
    """The same holds from a checkpoint, which stores the signal. A signal is evaluated at many times at once, and a
    function at each: the two are rounded apart, by less than 1e-15 of a source of size 1.
    """
    runs = []
    for time in (signal, lambda t: float(signal(t))):
        sim = fh.Simulation(LINE, MODEL, fh.Exact(), sources=[fh.Source("exp(-99*x**2)", time=time)], threads=1)
        sim.run(until=6.0)
        if time is signal:
            sim.save(tmp_path / "half.h5")
            sim = fh.Simulation.restore(tmp_path / "half.h5")
            assert sim.setup.sources[0].time.end == signal.end
        runs.append(sim.run(until=12.0).fields["u"])
    np.testing.assert_allclose(*runs, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "signal"),
    [
        ('{ type = "ricker", frequency = 0.1 }', fh.Ricker(0.1)),
        ('{ type = "tone-burst", frequency = 0.1, cycles = 3 }', fh.ToneBurst(0.1, 3)),
        ('{ type = "samples", values = [0.0, 1.0, 2.0, 1.0, 0.0], dt = 2.0 }', fh.Samples([0, 1, 2, 1, 0], 2.0)),
        ('"sin(t)"', fh.Expression("sin(t)", 0)),
    ],
)
def test_in_a_case_file(text, signal):
    (source,) = Case(f"{CASE}time = {text}").setup.sources
    times = np.linspace(0.0, 20.0, 41)
    np.testing.assert_array_equal([source.time(t) for t in times], [signal(t) for t in times])


def test_wherever_a_factor_of_time_is_taken():
    """Loads, incident waves and prescribed nodes accept signals, and report them by name."""
    text = """
    lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 12.0] }
    model = { type = "elastic", young = 1.0, kernel = { horizon = 2.0 } }
    boundary = { all = { type = "lattice-pml", nodes = 4 }, "y+" = { type = "free" } }
    run = { until = 20.0 }
    load = [
        { type = "body-force", value = ["exp(-x**2-y**2)", 0], time = { type = "gaussian", width = 9.0 } },
        { type = "traction", side = "y+", value = [0, 1], time = { type = "step", rise = 30.0 } },
    ]
    """
    case = Case(text)
    assert case.setup.loads[0].time == fh.Gaussian(9.0)
    sim = case.simulation(threads=1)
    assert [(key, signal.end) for key, signal in sim.signals] == [("load[0].time", 81.0), ("load[1].time", 30.0)]
    text = """
    lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 12.0] }
    model = { type = "wave", stencil = "finite-difference" }
    boundary = { all = { type = "fixed" } }
    run = { until = 20.0 }
    incident = [{ direction = [1, 0], signal = { type = "ricker", frequency = 0.05 }, duration = 60.0 }]
    [[constraint]]
    type = "prescribed"
    points = [[0, 0]]
    value = { type = "tone-burst", frequency = 0.05, cycles = 2 }
    """
    setup = Case(text).setup
    (wave,), (shaken,) = setup.sources, setup.constraints
    assert wave.signal == fh.Ricker(0.05) and wave.at(30.0) == 1.0
    assert shaken.value == fh.ToneBurst(0.05, 2) and shaken.at(10.0) == fh.ToneBurst(0.05, 2)(10.0)
    assert [key for key, _ in signals(setup)] == ["incident.signal", "constraint.value"]


def test_samples_lie_beside_the_case(tmp_path):
    np.savetxt(tmp_path / "wavelet.txt", np.sin(np.linspace(0, np.pi, 21)) ** 2)
    (tmp_path / "case.toml").write_text(f'{CASE}time = {{ type = "samples", values = "wavelet.txt", dt = 0.5 }}')
    (source,) = fh.read_case(tmp_path / "case.toml").setup.sources
    assert source.time.end == 10.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{ type = "riker", frequency = 0.1 }', "unknown type; value: riker; .*ricker, samples.*key|source.*time"),
        ("{ frequency = 0.1 }", r"source\[0\]\.time"),
        ('{ type = "ricker" }', r"missing key source\[0\]\.time\.frequency"),
        ('{ type = "ricker", frequency = 0.1, phase = 0 }', r"unknown key source\[0\]\.time\.phase.*frequency, delay"),
        ('{ type = "ricker", frequency = -1 }', r"source\.time\.frequency: must be finite and positive; value: -1"),
        ("[1.0]", r"source\[0\]\.time: must be a text or a number"),
    ],
)
def test_what_a_case_file_gets_wrong(text, message):
    with pytest.raises(fh.InputError, match=message):
        Case(f"{CASE}time = {text}")
