"""Cracks that run into the rim, where bonds cannot break."""

import warnings

import numpy as np
import pytest

import farhorizon as fh
from doubtful import CRACK_AT_THE_RIM
from farhorizon.cli import main
from farhorizon.files.results import open_results

LATTICE = fh.Lattice(1.0, (-12, -10), (12, 10))
CRACK = [[-5.0, 0.0], [5.0, 0.05]]


def pull(x, y):
    """Pull the two sides of the crack apart, over its whole length and beyond."""
    return np.sign(y) * np.exp(-((np.abs(y) - 3) ** 2)) * np.exp(-((x / 7) ** 8))


def plate(sides=None, strength=1.0, **options):
    """A plate whose bonds are nonlinear and break, with a crack that is pulled open along its whole length."""
    options = {"nonlinear": True, "critical_stretch": 0.02, **options}
    load = fh.BodyForce([0.0, pull], lambda t: 0.012 * strength * min(t / 8, 1.0))
    boundary = {"all": fh.LatticePML(nodes=8)} if sides is None else sides
    return fh.Simulation(LATTICE, fh.Elastic(fh.Kernel(2.0, 1), 1.0, **options), boundary, cracks=[CRACK], loads=[load])


def body(sides=None, strength=1.0):
    load = fh.BodyForce([0.0, pull], lambda t: 0.012 * strength * min(t / 8, 1.0))
    solid = fh.Correspondence(
        fh.Kernel(2.7, 0, "gaussian", 0.9, volume="full"), 1.0, 0.25, critical_stretch=0.02, drag=0.9
    )
    sides = fh.NonlocalPML(8, cross=0.1) if sides is None else sides
    return fh.Simulation(LATTICE, solid, sides, cracks=[CRACK], loads=[load])


def space():
    """A pulse in the middle of a cube, which breaks bonds there and travels to the sides."""
    pulse = "0.6*x*exp(-(x**2+y**2+z**2)/2.2)"
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, nonlinear=True, critical_stretch=0.02)
    lattice = fh.Lattice(1.0, (-7, -7, -6), (7, 7, 6))
    return fh.Simulation(lattice, model, fh.LatticePML(nodes=4), {"v": [pulse, "0", "0"]})


def overstretched(run, reach, nonlinear=True):
    """Whether any bond within one reach of the sides is stretched beyond 0.02, found bond by bond, without those that
    the crack cuts.
    """
    u, shape = run.fields["u"], run.lattice.shape
    points = np.stack(np.broadcast_arrays(*run.lattice.coordinates()), -1)
    rim = np.zeros(shape, bool)
    for index, n in zip(np.indices(shape), shape, strict=True):
        rim |= np.minimum(index, n - 1 - index) < reach
    for offset in run.stencil.offsets:
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, shape, strict=True))
        there = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset, shape, strict=True))
        eta, long = np.moveaxis(u[(slice(None), *there)] - u[(slice(None), *here)], 0, -1), np.linalg.norm(offset)
        length = np.linalg.norm(offset + eta, axis=-1) if nonlinear else long + eta @ offset / long
        whole = np.ones(length.shape, bool)
        if run.lattice.dim == 2:
            crossed = fh.Polyline(CRACK).cuts(points[here].reshape(-1, 2), points[there].reshape(-1, 2))
            whole = ~crossed.reshape(whole.shape)
        if ((length / long - 1 > 0.02) & (rim[here] | rim[there]) & whole).any():
            return True
    return False


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_bonds_that_break_by_energy_are_told_by_how_much_longer_they_are(share):
    """A jump beside a side stretches most the shortest bonds across it, which bear more than the longest ones."""
    solid = fh.Elastic(fh.Kernel(2.0, 1), 1.0, 0.2, material="correspondence", stabilisation=0.3, critical_stretch=0.02)
    longest = np.sqrt(5.0)  # longest bond; the shortest one across the jump is lengthened by all of it
    jump = {"u": [f"{share * 0.02 * longest}*(x > -11.5)*(x < 0)", "0"]}
    sim = fh.Simulation(LATTICE, solid, {"x": fh.LatticePML(nodes=8), "y": fh.Periodic()}, jump, dt=0.01)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        sim.step()
    assert any("where they cannot break" in str(one.message) for one in seen) == (share > 1)


@pytest.mark.parametrize(
    "make, nonlinear", [(plate, True), (lambda: plate(nonlinear=False), False), (body, False), (space, True)]
)
def test_the_first_bond_at_the_rim_that_would_break_is_told(make, nonlinear, tmp_path):
    """At the time that an examination of every bond after every step gives; once; and the caution is kept in
    checkpoints.
    """
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
    assert [str(w.message) for w in seen if w.category is fh.ValidityWarning] == [
        f"from t = {caution.time:.6g} on {caution.text}"
    ]
    assert {w.filename for w in seen if w.category is fh.ValidityWarning} == {__file__}  # the caller's file
    assert run.broken_bonds > 10 and first <= caution.time <= first + reach * 1.1  # a wave of speed 1 through the rim
    place = np.array(eval(caution.text.split("near ")[1].split(" are")[0]))
    assert (np.abs(place) >= run.lattice.upper - reach).any()
    run.save(tmp_path / "a.ckpt")
    again = make()
    again.load(tmp_path / "a.ckpt")
    assert again.cautions == run.cautions
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again.step(30)


@pytest.mark.parametrize("make", [plate, body])
def test_nothing_is_said_of_cracks_that_stay_inside_or_may_leave(make):
    """Under a weak pull, or with free sides, where bonds break as everywhere."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        weak, free = make(strength=0.05), make(sides=fh.Free())
        weak.run(40.0, progress=False)
        free.run(40.0, progress=False)
    assert not weak.cautions and not free.cautions and free.broken_bonds > 10


def test_results_pictures_and_the_command_line_tell(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(CRACK_AT_THE_RIM)
    assert main(["run", "a.toml"]) == 0
    said = capsys.readouterr().err
    assert said.count("stretched beyond the critical stretch") == 1 and "warning: not valid from t =" in said
    results = open_results("a.h5")
    (caution,) = results.cautions
    assert caution.brief == "crack where bonds cannot break" and results.to_xarray().attrs["cautions"] == [caution.text]
    titles = []
    monkeypatch.setattr(
        "farhorizon.pictures.result_pictures.field_panels",
        lambda panels, _axes, _path, look: titles.append(([panel.title for panel in panels], look.title)),
    )
    assert main(["plot", "a.h5", "--times", "0", "40"]) == 0
    panels, names = titles[-1]  # those of the damage, since u is zero at first
    assert panels == ["t = 0", "t = 40*"] and "* crack where bonds cannot break" in names
