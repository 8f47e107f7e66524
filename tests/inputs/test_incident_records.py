"""Near to near: the recorded waves of one run with a scatterer in another run, against one run with both."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.cli import main

_SOLID = {"influence": "linear", "exponent": 1}


def _burst(dim):
    """Return a source to the left of the box."""
    squares = {2: "((x+16)**2 + y**2)/2", 3: "((x+10)**2 + y**2 + z**2)*1.2"}[dim]
    return f"exp(-{squares})*exp(-((t-5)/2)**2)"


def _wave(dim):
    return fh.Wave(fh.Kernel(horizon=2.0 if dim == 2 else 1.0)), _burst(dim)


def _elastic(dim):
    kernel = fh.Kernel(horizon=2.0 if dim == 2 else 1.5, **_SOLID)
    return fh.Elastic(kernel, young=2.0, density=0.5), [_burst(dim), *["0.0"] * (dim - 1)]


# model and source, corners of the near field, half width of the box, and an end before which no echo returns
_CASES = {
    "scalar": (_wave(2), (-30, -22), (30, 22), 8, 28.0),
    "elastic": (_elastic(2), (-30, -22), (30, 22), 8, 12.0),
    "scalar in space": (_wave(3), (-17, -10, -10), (10, 10, 10), 5, 13.0),
    "elastic in space": (_elastic(3), (-17, -10, -10), (10, 10, 10), 5, 7.5),
}


def _runs(name, cut, dt=None):
    """Return the recorder and the run of the source alone, the run of source and crack, and the end of both."""
    (model, value), low, high, half, until = _CASES[name]
    lattice = fh.Lattice(1.0, low, high)
    dim = lattice.dim
    given = {"lattice": lattice, "model": model, "boundary": fh.Fixed(), "sources": [value]}
    shell = fh.ShellRecorder(fh.Box((-half,) * dim, (half,) * dim))
    first = fh.Simulation(**given, observe=[shell])
    first.run(until=until)
    both = fh.Simulation(**given, cracks=cut)
    both.run(until=until)
    return shell, first, both, until


def _cut(dim):
    if dim == 2:
        return [[(0.5, -2.0), (1.5, 2.0)]]
    return [fh.DiscCut((0.5, 0.0, 0.0), (1.0, 0.0, 0.0), 2.0)]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if "space" in name else []) for name in _CASES]
)
def test_the_second_run_is_that_of_both_together(name):
    """The second run agrees with it to rounding inside its box, as long as nothing returns from the fixed ends;
    outside the box it has the field scattered by the crack.
    """
    dim = len(_CASES[name][1])
    shell, first, both, until = _runs(name, _cut(dim))
    half = _CASES[name][3]
    lattice = fh.Lattice(1.0, (-half - 4,) * dim, (half + 4,) * dim)
    again = fh.Simulation(
        lattice, first.model, fh.LatticePML(nodes=12), sources=[fh.IncidentRecord(shell)], cracks=_cut(dim), dt=first.dt
    )
    again.run(until=until)
    large = tuple(slice(int(a), int(b) + 1) for a, b in zip(*(_places(both, x) for x in _ends(lattice)), strict=True))
    total, alone = (run.fields["u"][(..., *large)] for run in (both, first))
    inside = np.logical_and.reduce([np.abs(x) <= half for x in lattice.coordinates()])
    peak = np.abs(first.fields["u"]).max()
    scattered = np.abs(total - alone).max()
    assert np.abs(total[..., inside]).max() > 1e-2 * peak and scattered > 1e-3 * peak
    error = np.abs(again.fields["u"] - np.where(inside, total, total - alone))
    assert error[..., inside].max() < 1e-12 * peak
    assert error.max() < (1e-12 if dim == 2 else 1e-8) * peak  # the layer is thinner in 3D


@pytest.mark.parametrize("stabilisation", [None, 0.6], ids=["state-based", "correspondence"])
def test_below_a_free_surface_of_states(stabilisation):
    """The scatterer is a notch that opens at the surface, in a box that stands on it."""
    material = {"material": "state-based"}
    if stabilisation is not None:
        material = {"material": "correspondence", "stabilisation": stabilisation}
    model = fh.Elastic(fh.Kernel(1.4), 2.0, 0.2, density=0.5, **material)
    value = ["0.0", "exp(-((x+18)**2 + (y+6)**2)/2)*exp(-((t-5)/2)**2)"]
    given = {"lattice": fh.Lattice(1.0, (-34, -26), (34, 0)), "model": model, "sources": [value]}
    given["boundary"] = {"all": fh.Fixed(), "y+": fh.Free()}
    notch, shell = [[(0.5, -2.2), (0.5, 1.0)]], fh.ShellRecorder(fh.Box((-8.0, -10.0), (8.0, 0.0)))
    first = fh.Simulation(**given, observe=[shell]).run(14.0)
    both = fh.Simulation(**given, cracks=notch, dt=first.dt).run(14.0)
    lattice = fh.Lattice(1.0, (-14.0, -16.0), (14.0, 0.0))
    sides = {"all": fh.LatticePML(nodes=16), "y+": fh.Free()}
    wave = fh.IncidentRecord(shell)
    again = fh.Simulation(lattice, model, sides, sources=[wave], cracks=notch, dt=first.dt).run(14.0)
    large = (slice(None), slice(20, 49), slice(10, None))
    total, alone = both.fields["u"][large], first.fields["u"][large]
    x, y = lattice.coordinates()
    inside = (np.abs(x) <= 8) & (y >= -10)
    peak = np.abs(first.fields["u"]).max()
    assert np.abs(total[:, inside]).max() > 1e-2 * peak and np.abs(total - alone).max() > 1e-3 * peak
    error = np.abs(again.fields["u"] - np.where(inside, total, total - alone))
    assert error[:, inside].max() < 1e-12 * peak and error.max() < 1e-9 * peak


def test_what_is_in_the_box_in_both_runs_scatters_in_the_first():
    """With the crack of the first run, the second has the field of the first in the box and nothing outside; an
    additional crack scatters as in one run with both.
    """
    (model, value), low, high, half, until = _CASES["scalar"]
    given = {"model": model, "sources": [value], "boundary": fh.Fixed(), "lattice": fh.Lattice(1.0, low, high)}
    shell, old, new = fh.ShellRecorder(fh.Box((-half,) * 2, (half,) * 2)), _cut(2), [[(-2.0, 1.5), (-1.0, -1.5)]]
    first = fh.Simulation(**given, cracks=old, observe=[shell]).run(until)
    both = fh.Simulation(**given, cracks=old + new).run(until)
    lattice = fh.Lattice(1.0, (-12, -12), (12, 12))
    large = tuple(slice(int(n), int(n) + 25) for n in _places(first, lattice.lower))
    inside = np.max([np.abs(x) for x in lattice.coordinates()], axis=0) <= half
    options = {"lattice": lattice, "model": model, "boundary": fh.LatticePML(nodes=24), "dt": first.dt}
    for cracks, run in ((old, first), (old + new, both)):
        again = fh.Simulation(**options, sources=[fh.IncidentRecord(shell)], cracks=cracks).run(until)
        total, known = run.fields["u"][large], first.fields["u"][large]
        error = np.abs(again.fields["u"] - np.where(inside, total, total - known)).max()
        assert error < 1e-12 * np.abs(total).max()


def _ends(lattice):
    return lattice.lower, lattice.upper


def _places(run, point):
    return np.round((point - run.lattice.lower) / run.lattice.spacing)


def test_without_a_scatterer_nothing_leaves_and_files_hold_it(tmp_path, monkeypatch):
    """The record is in the results file of a case below a free surface that was interrupted half-way and resumed."""
    monkeypatch.chdir(tmp_path)
    text = """
    lattice = { spacing = 1.0, lower = [-24.0, -16.0], upper = [14.0, 0.0] }
    model = { type = "elastic", young = 2.0, kernel = { horizon = 2.0, exponent = 1, influence = "linear" } }
    boundary = { all = { type = "lattice-pml", nodes = 8 }, "y+" = { type = "free" } }
    source = [{ value = ["exp(-(x+16)**2 - (y+5)**2)*exp(-((t-5)/2)**2)", 0.0] }]
    shell = [{ box = { lower = [-8.0, -10.0], upper = [8.0, 0.0] } }]
    run = { until = 24.0 }
    output = { every = 8.0, pictures = [] }
    """
    (tmp_path / "a.toml").write_text(text)
    assert main(["run", "a.toml", "--out", "a", "--until", "8", "--no-report"]) == 0
    assert main(["run", "a.toml", "--out", "a", "--resume", "--no-report"]) == 0
    records = fh.open_results("a/a.h5").recorded["shell"]
    first = Case(text).simulation()
    first.run(24.0)
    np.testing.assert_array_equal(records.data["u"], first.recorders[0].data["u"])
    assert not list((tmp_path / "a" / "a").glob("shell*"))  # a shell has no picture
    (tmp_path / "b.toml").write_text(
        text.replace("-24.0, -16.0", "-12.0, -14.0")
        .replace("14.0, 0.0", "12.0, 0.0")
        .replace('source = [{ value = ["exp(-(x+16)**2 - (y+5)**2)*exp(-((t-5)/2)**2)", 0.0] }]', "")
        .replace("shell = [{ box = { lower = [-8.0, -10.0], upper = [8.0, 0.0] } }]", "")
        + '[[incident]]\ntype = "incident-record"\nrecord = "a/a.h5"\n'
    )
    again = fh.read_case("b.toml").simulation()
    assert again.dt == pytest.approx(first.dt, rel=1e-12)
    again.run(24.0)
    x, y = again.lattice.coordinates()
    inside = (np.abs(x) <= 8) & (y >= -10)
    expected = np.where(inside, first.fields["u"][:, 12:37, 2:], 0.0)
    assert np.abs(expected).max() > 0.01
    assert np.abs(again.fields["u"] - expected).max() < 1e-12
    again.save("b.ckpt")
    other = fh.Simulation.restore("b.ckpt")
    np.testing.assert_array_equal(other.fields["u"], again.fields["u"])
    with pytest.raises(fh.InputError, match="end before the run"):
        again.run(30.0)


def _record(**changes):
    """Return the record of a short run."""
    shell = fh.ShellRecorder(fh.Box((-6, -6), (6, 6)))
    given = {
        "lattice": fh.Lattice(1.0, (-20, -12), (12, 12)),
        "model": fh.Wave(fh.Kernel(2.0)),
        "sources": ["exp(-((x+14)**2 + y**2))*sin(t)"],
        "dt": 0.25,
    }
    sim = fh.Simulation(**{**given, **changes}, observe=[shell])
    sim.step(4)
    return shell


def _refused(match, **changes):
    given = {"lattice": fh.Lattice(1.0, (-10, -10), (10, 10)), "model": fh.Wave(fh.Kernel(2.0)), "dt": 0.25}
    with pytest.raises(fh.InputError, match=match):
        fh.Simulation(**{**given, **changes}, sources=[fh.IncidentRecord(_record())]).step(9)


def test_what_does_not_fit_is_refused():
    _refused("another time step", dt=0.2)
    _refused("another medium", model=fh.Wave(fh.Kernel(2.0), speed=0.9))
    _refused("other nodes", lattice=fh.Lattice(1.0, (-10.5, -10), (10.5, 10)))
    _refused("other nodes", model=fh.Wave(fh.Kernel(2.0, exponent=1, influence="linear", volume="full"), speed=1.0))
    _refused("dimension", lattice=fh.Lattice(1.0, -20, 20))
    _refused("one reach of the near field", lattice=fh.Lattice(1.0, (-7, -7), (7, 7)))
    _refused("end before the run")
    for wrong in ("no such file.h5", 3.0, {"points": [[0.0]]}, fh.ShellRecorder()):
        with pytest.raises(fh.InputError):
            fh.IncidentRecord(wrong)


def test_what_cannot_be_recorded_is_refused():
    for match, changes in {
        "acts inside": {"sources": ["exp(-(x**2 + y**2))*sin(t)"]},
        "begin at rest": {"initial": {"u": "exp(-(x**2 + y**2))"}},
        "not uniform": {"cracks": [[(5.0, 0.5), (9.0, 0.5)]]},
        "second order": {"model": fh.Diffusion(fh.Kernel(2.0)), "dt": None},
        "comes in inside": {"sources": [fh.IncidentWave((1, 0), "sin(t/4)**4", 12.6, within=fh.Box((-8, -5), (5, 5)))]},
    }.items():
        with pytest.raises(fh.InputError, match=match):
            _record(**changes)


def test_how_much_is_recorded_is_said():
    shell = fh.ShellRecorder()
    sim = fh.Simulation(
        fh.Lattice(1.0, (-12, -12), (12, 12)), fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=8), observe=[shell]
    )
    assert any("records the shell of a box: about" in note for note in sim.check(until=10.0).notes)
