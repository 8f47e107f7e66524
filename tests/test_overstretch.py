"""Cracks that run into the rim, where bonds cannot break."""

import warnings

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.cli import main
from farhorizon.results import open_results

LATTICE = fh.Lattice(1.0, (-12, -10), (12, 10))
CRACK = [[-5.0, 0.0], [5.0, 0.05]]


def pull(x, y):
    """Apart, on both sides of the crack, over its whole length and beyond."""
    return np.sign(y) * np.exp(-((np.abs(y) - 3) ** 2)) * np.exp(-((x / 7) ** 8))


def plate(sides=None, strength=1.0, **options):
    """Bonds that are nonlinear and break; a crack that is pulled open along its whole length."""
    options = {"nonlinear": True, "critical_stretch": 0.02, **options}
    load = fh.BodyForce([0.0, pull], lambda t: 0.012 * strength * min(t / 8, 1.0))
    boundary = {"all": fh.LatticePML(nodes=8)} if sides is None else sides
    return fh.Simulation(LATTICE, fh.Elastic(fh.Kernel(2.0, 1), 1.0, **options), boundary, cracks=[CRACK], loads=[load])


def body(sides=None, strength=1.0):
    load = fh.BodyForce([0.0, pull], lambda t: 0.012 * strength * min(t / 8, 1.0))
    boundary = fh.NonlocalPML(8, cross=0.1) if sides is None else sides
    return fh.Body(LATTICE, fh.Kernel(2.7, 0, "gaussian", 0.9, volume="full"), young=1.0, poisson=0.25, critical_stretch=0.02, drag=0.9,
                   boundary=boundary, cracks=[CRACK], loads=[load])  # fmt: skip


def overstretched(run, reach, nonlinear=True):
    """Whether any bond with an end within one reach of the sides is stretched beyond 0.02; bond by bond, without those that the crack cuts."""
    u, (nx, ny) = run.fields["u"], run.lattice.shape
    x, y = run.lattice.coordinates()
    i, j = np.indices((nx, ny))
    rim = (np.minimum(i, nx - 1 - i) < reach) | (np.minimum(j, ny - 1 - j) < reach)
    offsets = run.stencil.offsets
    for a, b in offsets:
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip((a, b), (nx, ny), strict=True))
        there = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip((a, b), (nx, ny), strict=True))
        eta = u[(slice(None), *there)] - u[(slice(None), *here)]
        length = np.hypot(a + eta[0], b + eta[1]) if nonlinear else np.hypot(a, b) + (a * eta[0] + b * eta[1]) / np.hypot(a, b)
        stretch = length / np.hypot(a, b) - 1
        crossed = fh.Polyline(CRACK).cuts(np.stack([x[here], y[here]], -1).reshape(-1, 2), np.stack([x[there], y[there]], -1).reshape(-1, 2))
        if ((stretch > 0.02) & (rim[here] | rim[there]) & ~crossed.reshape(stretch.shape)).any():
            return True
    return False


@pytest.mark.parametrize("make, nonlinear", [(plate, True), (lambda: plate(nonlinear=False), False), (body, True)])
def test_the_first_bond_at_the_rim_that_would_break_is_told(make, nonlinear, tmp_path):
    """At the time that all bonds, looked at one by one after every step, give; once; it goes with checkpoints."""
    run = make()
    reach = max(run.stencil.reach)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        while not overstretched(run, reach, nonlinear):
            assert not run.cautions and run.time < 80
            run.step()
        first = run.time
        run.step(40)
    (caution,) = run.cautions
    assert [str(w.message) for w in seen if w.category is fh.ValidityWarning] == [f"from t = {caution.time:.6g} on {caution.text}"]
    assert run.broken_bonds > 10 and first <= caution.time <= first + reach * 1.1  # a wave of speed 1 through the rim
    place = np.array(eval(caution.text.split("near ")[1].split(" are")[0]))
    assert (np.abs(place) >= LATTICE.upper - reach).any()
    run.save(tmp_path / "a.ckpt")
    again = make()
    again.load(tmp_path / "a.ckpt")
    assert again.cautions == run.cautions
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again.step(30)


@pytest.mark.parametrize("make", [plate, body])
def test_nothing_is_said_of_cracks_that_stay_inside_or_may_leave(make):
    """A weak pull; free sides, at which bonds break as everywhere."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        weak, free = make(strength=0.05), make(sides=fh.Free())
        weak.run(40.0, progress=False)
        free.run(40.0, progress=False)
    assert not weak.cautions and not free.cautions and free.broken_bonds > 10


CASE = """
[lattice]
spacing = 1.0
lower = [-12.0, -10.0]
upper = [12.0, 10.0]
[model]
type = "elastic"
young = 1.0
nonlinear = true
critical_stretch = 0.02
[model.kernel]
horizon = 2.0
exponent = 1
[boundary]
all = { type = "lattice-pml", nodes = 8 }
[[crack]]
points = [[-5.0, 0.0], [5.0, 0.05]]
[[load]]
type = "body-force"
value = [0.0, "sign(y)*exp(-(abs(y)-3)**2)*exp(-(x/7)**8)"]
time = "0.012*min(t/8, 1)"
[run]
until = 40.0
[output]
every = 4.0
"""


def test_results_pictures_and_the_command_line_tell(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(CASE)
    assert main(["run", "a.toml"]) == 0
    said = capsys.readouterr().err
    assert said.count("stretched beyond the critical stretch") == 1 and "warning: not valid from t =" in said
    results = open_results("a.h5")
    (caution,) = results.cautions
    assert caution.brief == "crack at the rim" and results.to_xarray().attrs["cautions"] == [caution.text]
    titles = []
    monkeypatch.setattr("farhorizon.plot.field_panels", lambda fields, *_args, **_names: titles.append([title for title, _ in fields]))
    assert main(["plot", "a.h5", "--times", "0", "40"]) == 0
    assert titles[0] == ["t = 0", "t = 40, crack at the rim"]
