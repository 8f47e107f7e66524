"""Rayleigh waves: exact on the lattice, and the signal where they meet the box."""

import numpy as np
import pytest

import farhorizon as fh

_SIGNAL = fh.Expression("sin(2*pi*t/16)*exp(-((t-60)/12)**2)", 0)


def _solid(reach=2.5):
    return fh.Elastic(fh.Kernel(horizon=reach, influence="linear", exponent=1), young=2.0, density=0.1)


def _ground(half, dim=2):
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * (dim - 1) + (0,))
    return lattice, {"all": fh.LatticePML(nodes=3), "xyz"[dim - 1] + "+": fh.Free()}


def _states(reach, **constants):
    return fh.Elastic(fh.Kernel(reach), young=2.0, density=0.1, **constants)


_IN_SPACE = (1.0, 0.3, 0.0)
_CASES = {
    "bonds": (_solid(), (-1.0, 0.0)),
    "states": (_states(2.0, poisson=0.4, material="state-based"), (1.0, 0.0)),
    "correspondence": (_states(2.0, poisson=0.1, material="correspondence", stabilisation=0.8), (-1.0, 0.0)),
    "bonds in space": (_solid(1.5), _IN_SPACE),
    "states in space": (_states(1.0, poisson=0.35, material="state-based"), _IN_SPACE),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if "space" in name else []) for name in _CASES]
)
def test_without_a_scatterer_nothing_leaves_the_box(name):
    model, direction = _CASES[name]
    dim = len(direction)
    lattice, sides = _ground(2 * max(model.stencil(1.0, dim).reach) + 16 if dim == 2 else 9, dim)
    sim = fh.Simulation(lattice, model, sides, sources=[fh.RayleighWave(direction, _SIGNAL, 120.0)])
    low, high = sim.incident[0].wave.within.bounds()
    assert high[-1] == 0
    inside = np.logical_and.reduce(
        [(x >= a - 1e-9) & (x <= b + 1e-9) for x, a, b in zip(lattice.coordinates(), low, high, strict=True)]
    )
    seen = 0.0
    for t in (0.0, 40.0, 60.0, 90.0):
        sim.run(until=t)
        incident, u = sim.incident[0].field(sim.time), sim.fields["u"]
        seen = max(seen, np.abs(incident[..., inside]).max())
        assert np.abs(u - incident)[..., inside].max() < 1e-12
        assert np.abs(u[..., ~inside]).max() < 1e-12
    assert seen > 0.8
    (note,) = [note for note in sim.notes if "has a tail" in note]
    assert "the run begins with it" in note


def test_the_signal_is_the_normal_displacement_where_the_box_begins():
    lattice, sides = _ground(16)
    wave = fh.RayleighWave((-1.0, 0.0), _SIGNAL, 120.0, fh.Box((-9.0, -8.0), (7.0, 0.0)))
    incident = fh.Simulation(lattice, _solid(), sides, sources=[wave]).incident[0]
    corner = lattice.index((7.0, 0.0))
    for t in (45.0, 52.5, 60.0, 71.0):
        at = incident.field(t)[(slice(None), *corner)]
        assert at[1] == pytest.approx(wave.at(t), abs=2e-4)  # the tail of the burst is about 1e-4


def _refused(match, boundary=None, model=None, **changes):
    lattice, sides = _ground(16)
    with pytest.raises(fh.InputError, match=match):
        wave = fh.RayleighWave(**{"direction": (1.0, 0.0), "signal": _SIGNAL, "duration": 120.0, **changes})
        fh.Simulation(lattice, model or _solid(2.0), boundary or sides, sources=[wave])


def test_bad_input():
    _refused("direction", direction=(0.0, 0.0))
    _refused("dimension", direction=(1.0, 0.0, 0.0))
    _refused("duration", duration=-1.0)
    _refused("along a free side", direction=(1.0, 0.1))
    _refused("along a free side", boundary=fh.LatticePML(nodes=3))
    _refused("along a free side", within=fh.Box((-8, -12), (8, -3)))
    _refused("no Rayleigh waves", model=fh.Wave(fh.Kernel(2.0)))
    # its short waves of zero energy extract energy from waves along the surface
    _refused("runs along the surface", model=_states(2.0, poisson=0.3, material="correspondence"))
    _refused("frequencies which the lattice does not carry", signal=lambda t: 1.0)


def test_case_file():
    from farhorizon.case.case import Case

    text = """
    lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 0.0] }
    model = { type = "elastic", young = 1.0, kernel = { horizon = 2.0, exponent = 1, influence = "linear" } }
    boundary = { all = { type = "lattice-pml", nodes = 3 }, "y+" = { type = "free" } }
    run = { until = 1.0 }
    [[incident]]
    type = "rayleigh-wave"
    direction = [1.0, 0.0]
    signal = { type = "ricker", frequency = 0.02 }
    duration = 120.0
    """
    wave = Case(text).simulation().incident[0].wave
    assert wave.within.bounds()[1].tolist() == [10.0, 0.0]
    with pytest.raises(fh.InputError, match="did you mean 'direction'"):
        Case(text.replace("direction", "directon"))
