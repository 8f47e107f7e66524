"""What gradients refuse, before any step."""

import numpy as np
import pytest

import farhorizon as fh

LATTICE = fh.Lattice(1.0, (-9.0, -8.0), (9.0, 9.0))
KERNEL = fh.Kernel(2.0)
PULSE = "exp(-x**2 - y**2)"


def asked(model=None, wrt="speed", data=None, points=((3.0, 2.0),), region=None, setup=None, until=4.0, **options):
    given = {"dt": 0.4, "initial": {"u": PULSE}, **options}
    made = fh.Setup(LATTICE, model or fh.Wave(KERNEL), **given) if setup is None else setup
    misfit = fh.LeastSquares(fh.Receivers(points), np.zeros((11, len(points))) if data is None else data)
    return fh.gradient(made, misfit, wrt, until, region=region)


def solid(**options):
    return fh.Elastic(KERNEL, 1.0, **options)


WAVE = {"initial": {"u": PULSE}}
SOLID = {"initial": {"u": [PULSE, 0.0]}}
EDGE = np.zeros(LATTICE.shape, bool)
EDGE[2, 7] = True
CASES = {
    "plane waves": ({"boundary": fh.PlaneWave()}, "boundary.x-", "PlaneWave", "LatticePML"),
    "higdon": ({"boundary": {"x-": fh.Higdon(), "all": fh.Fixed()}}, "boundary.x-", "Higdon", "LatticePML"),
    "first order": ({"boundary": fh.FirstOrder(), "lattice": "window"}, "boundary.x-", "FirstOrder", "LatticePML"),
    "nonlinear bonds": (
        {"model": solid(nonlinear=True, contact=False), "wrt": "young", **SOLID},
        "model.nonlinear",
        "True",
        "leave",
    ),
    "contact": ({"model": solid(contact=True), "wrt": "young", **SOLID}, "model.contact", "True", "leave"),
    "breaking bonds": (
        {"model": solid(critical_stretch=0.1), "wrt": "young", **SOLID},
        "model.critical_stretch",
        "0.1",
        "leave",
    ),
    "softening": (
        {"model": solid(critical_stretch=0.1, fracture_energy=0.1, softening="linear"), "wrt": "young", **SOLID},
        "model.softening",
        "True",
        "leave",
    ),
    "drag": (
        {"model": fh.Correspondence(KERNEL, 1.0, 0.2, drag=0.3), "wrt": "u", **SOLID},
        "model.drag",
        "0.3",
        "damping",
    ),
    "a source of the field": ({"sources": ["u*(1 - u)"]}, "source", "OfField", "background"),
    "several stages": (
        {"model": fh.Diffusion(KERNEL, integrator="rk4"), "wrt": "diffusivity", "dt": None},
        "model.integrator",
        "Runge-Kutta",
        "euler",
    ),
    "corrosion": (
        {"model": fh.Corrosion(KERNEL, saturation=0.5), "wrt": "u", "dt": None},
        "model",
        "Corrosion",
        "Diffusion",
    ),
    "opening crack": (
        {"cracks": [fh.Crack([(-2.0, 0.5), (2.0, 0.5)], opens=1.0)]},
        "crack.opens",
        "1",
        "from the start",
    ),
    "released nodes": (
        {"constraints": [fh.Prescribed([(0.0, 0.0)], 0.0, until=1.0)]},
        "constraint",
        "until = 1",
        "Prescribed",
    ),
    "temperature": (
        {
            "model": fh.Diffusion(KERNEL),
            "wrt": "u",
            "dt": None,
            "constraints": [fh.Temperature(fh.Disc(radius=2.0), 1.0)],
        },
        "constraint",
        "Temperature",
        "Prescribed",
    ),
    "the smaller of two": ({"rule": "both"}, "rule", "both", "harmonic"),
    "a constant of another model": ({"wrt": "young"}, "wrt", "young", "one of these"),
    "a misspelt constant": ({"wrt": "densty"}, "wrt", "densty", "density"),
    "no source": ({"wrt": "source"}, "wrt", "source", ""),
    "nothing": ({"wrt": []}, "wrt", "", "speed"),
    "another length": ({"data": np.zeros((10, 1))}, "misfit.data.u", "10, 1", "one row"),
    "another number": ({"data": np.zeros((11, 2))}, "misfit.data.u", "11, 2", "one row"),
    "a receiver outside": ({"points": [(11.0, 0.0)]}, "receivers.points", "11", "inside"),
    "a region near layers": ({"region": EDGE, "boundary": fh.LatticePML(nodes=6)}, "region", "1 nodes", "region=None"),
    "an empty region": ({"region": fh.Disc(radius=0.1, centre=(0.5, 0.5))}, "region", "0", "larger"),
    "a region of another shape": ({"region": np.ones((3, 3), bool)}, "region", "3, 3", "shape"),
}


@pytest.mark.parametrize("case", CASES)
def test_refused(case, monkeypatch):
    options, key, value, remedy = CASES[case]
    options = dict(options)
    if options.pop("lattice", ""):
        monkeypatch.setitem(globals(), "LATTICE", fh.Lattice(1.0, window=fh.Disc(radius=12.0)))

    def never(self, count=1):
        raise AssertionError("a step was made")

    monkeypatch.setattr(fh.Simulation, "step", never)
    with pytest.raises(fh.InputError) as told:
        asked(**options)
    assert told.value.key == key
    assert value in str(told.value) and remedy in str(told.value)


def test_data_and_weights():
    line = fh.Receivers([(3.0, 2.0)])
    with pytest.raises(fh.InputError, match="finite"):
        fh.LeastSquares(line, np.full((11, 1), np.nan))
    with pytest.raises(fh.InputError, match="negative"):
        fh.LeastSquares(line, np.zeros((11, 1)), weights=-1.0)
    with pytest.raises(fh.InputError, match="no gradient"):
        fh.LeastSquares(fh.Receivers([(3.0, 2.0)], "gradient"), np.zeros((11, 1)))
    with pytest.raises(fh.InputError, match="do not record"):
        fh.LeastSquares(line, {"v": np.zeros((11, 1))})
    with pytest.raises(fh.InputError, match="function of"):
        fh.OwnMisfit(line, 3.0)
    own = fh.OwnMisfit(line, lambda records, times: (0.0, {"u": np.zeros(3)}))
    with pytest.raises(fh.InputError, match="shape"):
        fh.gradient(fh.Setup(LATTICE, fh.Wave(KERNEL), initial={"u": PULSE}), own, "u", 1.0)
