"""Plane waves that arrive from far away: exact on the lattice, so that a box without a scatterer leaks nothing."""

import numpy as np
import pytest

import farhorizon as fh

# A burst of angular frequency 0.39 and width 12: it is 1e-11 at its ends, and 1e-12 of it lies above the lattice's
# frequencies (from 0.8 on for the S waves below).
_SIGNAL = fh.Expression("sin(2*pi*t/16)*exp(-((t-60)/12)**2)", 0)
_DURATION = 120.0
_EXACT = 1e-11  # size of the burst where it is cut off


def _bonds(reach, **constants):
    return fh.Elastic(
        fh.Kernel(horizon=reach, influence="linear", exponent=1), **{"young": 2.0, "density": 0.5, **constants}
    )


_CASES = {
    "line": (fh.Wave(fh.Kernel(horizon=3.0)), (1.0,), "P", 20),
    "plane, along an axis": (fh.Wave(fh.Kernel(horizon=3.0)), (0.0, -2.0), "P", 20),
    "plane, oblique": (fh.Wave(fh.Kernel(horizon=3.0)), (1.0, 0.3), "P", 20),
    "P": (_bonds(2.5), (1.0, 0.3), "P", 20),
    "S": (_bonds(2.5, density=0.2), (-0.4, 1.0), "S", 20),
    "S of finite elements": (
        fh.Elastic(young=1.0, poisson=0.3, density=0.1, material="finite-element"),
        (-0.4, 1.0),
        "S",
        20,
    ),
    "S in space": (_bonds(1.5), (1.0, 0.3, 0.2), (-0.3, 1.0, 0.0), 8),
}


def _mask(sim):
    """Return which nodes lie in the box of the first incident wave."""
    lattice, box = sim.lattice, sim.incident[0].wave.within
    inside = [
        (x >= low - 1e-9) & (x <= high + 1e-9)
        for x, low, high in zip(lattice.coordinates(), *box.bounds(), strict=True)
    ]
    return np.logical_and.reduce(inside)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if "space" in name else []) for name in _CASES]
)
def test_without_a_scatterer_nothing_leaves_the_box(name):
    model, direction, polarisation, half = _CASES[name]
    lattice = fh.Lattice(spacing=1.0, lower=(-half,) * len(direction), upper=(half,) * len(direction))
    wave = fh.IncidentWave(direction, _SIGNAL, _DURATION, polarisation)
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=3), sources=[wave])
    inside, seen = _mask(sim), 0.0
    for t in (30.0, 60.0, 90.0, 130.0):
        sim.run(until=t)
        incident, u = sim.incident[0].field(sim.time), sim.fields["u"]
        seen = max(seen, np.abs(incident[..., inside]).max())
        assert np.abs(u - incident)[..., inside].max() < _EXACT
        assert np.abs(u[..., ~inside]).max() < _EXACT
    assert seen > 0.5  # a wave has passed


def test_the_signal_is_where_the_wave_meets_the_box():
    lattice = fh.Lattice(spacing=0.5, lower=(-10, -10), upper=(10, 10))
    wave = fh.IncidentWave(
        (3.0, 4.0),
        lambda t: np.sin(2 * np.pi * t / 8) * np.exp(-(((t - 30) / 6) ** 2)),
        60.0,
        "S",
        fh.Box((-6, -6), (6, 6)),
    )
    sim = fh.Simulation(lattice, _bonds(1.0, density=0.8), sources=[wave])
    corner = lattice.index((-6, -6))
    for _ in range(12):
        sim.step(15)
        u, v = sim.incident[0].field(sim.time)[(slice(None), *corner)]
        expected = wave.at(sim.time)
        # (k dx)^2/12: S waves of a lattice are transverse only approximately
        np.testing.assert_allclose((-0.8 * u + 0.6 * v, 0.6 * u + 0.8 * v), (expected, 0.0), atol=1e-2)
        np.testing.assert_allclose(sim.fields["u"][(slice(None), *corner)], (u, v), atol=1e-9)


def _scattered(upper, model, direction, polarisation):
    """Return the field scattered by a crack in a box with corners at (-13, -13) and `upper`."""
    lattice = fh.Lattice(spacing=1.0, lower=(-20, -20), upper=(26, 26))
    wave = fh.IncidentWave(direction, _SIGNAL, _DURATION, polarisation, fh.Box((-13, -13), upper))
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=24), sources=[wave], cracks=[[(-3.5, -4.0), (3.5, 2.0)]])
    sim.run(until=90.0)
    return sim.fields["u"] - np.where(_mask(sim), sim.incident[0].field(sim.time), 0.0)


@pytest.mark.parametrize(("name", "polarisation"), [("plane, oblique", "P"), ("P", "P"), ("P", "S")])
def test_what_a_crack_scatters_does_not_know_the_box(name, polarisation):
    model, direction, _, _ = _CASES[name]
    small, large = (_scattered(upper, model, direction, polarisation) for upper in ((13, 14), (22, 20)))
    assert np.abs(large).max() > 0.1
    assert np.abs(small - large).max() < _EXACT


def test_a_cut_line_reflects_all():
    """A free end: the reflected wave is the mirror image of the incident one, and nothing moves beyond the cut."""
    lattice = fh.Lattice(spacing=1.0, lower=-60, upper=60)
    wave = fh.IncidentWave((1.0,), _SIGNAL, _DURATION, within=fh.Box(-40, 40))
    # with bonds to the next node only
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(horizon=1.4)), fh.Exact(), sources=[wave], cracks=[0.5])
    sim.run(until=150.0)
    u, incident = sim.fields["u"], sim.incident[0].field(sim.time)
    x = lattice.axes[0]
    assert np.abs(u[(x > 0.5) & (x <= 40)]).max() < _EXACT
    front = (x < 0.5) & (x >= -40)
    mirrored = np.interp(1 - x[front], x, incident)  # the cut is the mirror
    assert np.abs(mirrored).max() > 0.5
    assert np.abs(u[front] - incident[front] - mirrored).max() < _EXACT


def test_two_waves_add_up():
    lattice = fh.Lattice(spacing=1.0, lower=(-12, -12), upper=(12, 12))
    waves = [fh.IncidentWave(d, _SIGNAL, _DURATION, p) for d, p in (((1.0, 0.0), "P"), ((0.0, 1.0), "S"))]
    both, one, two = (
        fh.Simulation(lattice, _bonds(2.5), sources=some).run(until=60.0).fields["u"]
        for some in (waves, waves[:1], waves[1:])
    )
    assert np.abs(both - one - two).max() < 1e-13


@pytest.mark.parametrize("young", [2.0, "where(y > 2.2, 1.2, 2)"], ids=["uniform", "strata"])
def test_restored_runs_are_bitwise_the_same(tmp_path, young):
    lattice = fh.Lattice(spacing=1.0, lower=(-12, -12), upper=(12, 12))
    wave = fh.IncidentWave((1.0, 0.5), _SIGNAL, _DURATION, "S")
    model, crack = _bonds(2.5, young=young), [[(-2.5, 0.5), (2.5, 0.5)]]
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=8), sources=[wave], cracks=crack)
    sim.run(until=50.0)
    sim.save(tmp_path / "run.ckpt")
    again = fh.Simulation.restore(tmp_path / "run.ckpt")
    for run in (sim, again):
        run.run(until=70.0)
    np.testing.assert_array_equal(again.fields["u"], sim.fields["u"])


def _refused(match, model=None, lattice=None, **changes):
    wave = {"direction": (1.0, 0.0), "signal": _SIGNAL, "duration": _DURATION} | changes.pop("wave", {})
    with pytest.raises(fh.InputError, match=match):
        fh.Simulation(
            lattice or fh.Lattice(1.0, (-12, -12), (12, 12)),
            model or _bonds(2.5),
            sources=[fh.IncidentWave(**wave)],
            **changes,
        )


def test_bad_input():
    _refused("direction", wave={"direction": (0.0, 0.0)})
    _refused("direction: is beyond what can be computed with", wave={"direction": (1e300, 0.0)})
    _refused("dimension", wave={"direction": (1.0, 0.0, 0.0)})
    _refused("duration", wave={"duration": 0.0})
    _refused("duration: the signal lasts too many time steps.*limit: .* 1000000 steps", wave={"duration": 1e30})
    _refused("polarisation", wave={"polarisation": "Q"})
    _refused("along its direction", wave={"polarisation": (1.0, 1.0)})
    _refused("one reach of the near field", wave={"within": fh.Box((-11, -8), (8, 8))})
    _refused("too small", wave={"within": fh.Box((-3, -3), (3, 3))})
    _refused("frequencies which the lattice does not carry", wave={"signal": lambda t: 1.0})
    _refused("is zero", wave={"signal": lambda t: 0.0})
    _refused("must be finite", wave={"signal": lambda t: np.inf})
    _refused("a crack reaches", cracks=[[(-7.0, 0.5), (0.0, 0.5)]])
    corner = np.where(np.arange(25) < 5, 1.0, 0.5)
    _refused("not uniform", model=fh.Wave(fh.Kernel(2.5)), coefficient=np.maximum.outer(corner, corner))
    _refused("undamped medium", model=fh.Wave(fh.Kernel(2.5), damping=0.1))
    _refused("undamped medium", model=fh.Diffusion(fh.Kernel(2.5)))
    space = fh.Lattice(1.0, (-6,) * 3, (6,) * 3)
    _refused(
        "needs the direction of its displacement",
        lattice=space,
        model=_bonds(1.5),
        wave={"direction": (1, 0, 0), "polarisation": "S"},
    )


def test_case_file():
    from farhorizon.case.case import Case

    text = """
    lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 12.0] }
    model = { type = "elastic", young = 1.0, kernel = { horizon = 2.0, exponent = 1, influence = "linear" } }
    run = { until = 1.0 }
    [[incident]]
    direction = [1.0, 0.0]
    polarisation = [0.0, 1.0]
    signal = "SIGNAL"
    duration = 120.0
    within = { lower = [-6.0, -5.0], upper = [6.0, 5.0] }
    """
    wave = Case(text.replace("SIGNAL", _SIGNAL.text)).simulation().incident[0].wave
    assert wave.within.bounds()[1].tolist() == [6.0, 5.0]
    with pytest.raises(fh.InputError, match=r"incident\.signal: there is no x"):
        Case(text.replace("SIGNAL", "exp(-x)"))
    with pytest.raises(fh.InputError, match="did you mean 'direction'"):
        Case(text.replace("direction", "directon"))
    with pytest.raises(fh.InputError, match=r'unknown type; value: rayleigh; .*remedy: type = "rayleigh-wave"'):
        Case(text.replace("direction", 'type = "rayleigh"\n    direction'))


def test_notes():
    lattice = fh.Lattice(1.0, (-12, -12), (12, 12))
    cut = fh.IncidentWave((1.0, 0.0), lambda t: np.sin(t / 3) ** 2, 3 * np.pi)  # with a jump of its second derivative
    report = str(fh.Simulation(lattice, _bonds(2.5), {"x": fh.LatticePML(), "y": fh.Free()}, sources=[cut]).check())
    assert "shorter than the lattice carries" in report
    assert "only what is scattered meets y-, y+" in report


def _under_a_surface(half, dim=2, side=1):
    """Return a lattice with a free end at 0 along its last axis, and its sides."""
    low, high = (-half,) * (dim - 1), (half,) * (dim - 1)
    ends = ((-half,), (0,)) if side > 0 else ((0,), (half,))
    lattice = fh.Lattice(1.0, low + ends[0], high + ends[1])
    return lattice, {"all": fh.LatticePML(nodes=3), "xyz"[dim - 1] + "-+"[side > 0]: fh.Free()}


def _states(reach, poisson, **constants):
    """Return a state-based material, or a correspondence material if a stabilisation is given."""
    material = "correspondence" if "stabilisation" in constants else "state-based"
    return fh.Elastic(
        fh.Kernel(reach), poisson=poisson, **{"young": 2.0, "density": 0.2, "material": material, **constants}
    )


_AT_A_SURFACE = {
    "scalar": (fh.Wave(fh.Kernel(horizon=3.0)), (1.0, 0.7), "P", 1),
    "P onto a lower side": (_bonds(2.5), (-1.0, -2.0), "P", -1),
    "S beyond the critical angle": (_bonds(2.5, density=0.2), (1.0, 1.0), "S", 1),
    "S straight up": (_bonds(2.5, density=0.2), (0.0, 1.0), "S", 1),
    "P in states": (_states(2.0, 0.4), (1.0, 1.2), "P", 1),
    "S in states beyond the critical angle": (_states(2.0, 0.35, plane="stress"), (-1.0, -1.0), "S", -1),
    "P in a correspondence material": (_states(2.0, 0.1, stabilisation=0.8), (-1.0, 1.0), "P", 1),
    "S in a correspondence material, not stabilised": (_states(2.0, 0.3, stabilisation=0.0), (-1.0, 2.0), "S", 1),
    "P in space": (_bonds(1.5, density=0.2), (1.0, 0.3, 1.5), "P", 1),
    "P in states in space": (_states(1.0, 0.35), (1.0, 0.3, 1.5), "P", 1),
    "SV in a correspondence material in space": (_states(1.0, 0.2, stabilisation=0.5), (1, 0, -2), (2, 0, 1), -1),
    "SH and SV in space": (_bonds(1.5, density=0.2), (1.0, 0.3, -2.0), (2.0, 1.0, 1.15), -1),
}


def _above(level, upper, lower):
    """A constant of two media, one of them above a level of the last axis."""
    return lambda *places: np.where(places[-1] > level, upper, lower)


#: As above, where the medium differs above a level; the first ones have no free side.
_IN_STRATA = {
    "scalar, open": (fh.Wave(fh.Kernel(2.0), speed=_above(2.5, 0.7, 1.0)), (1.0, 0.7), "P", 0),
    "states, open, from above": (
        _states(2.0, _above(0.5, 0.35, 0.28), young=_above(0.5, 1.5, 2.0), density=_above(0.5, 0.17, 0.2)),
        (1.0, -1.7),
        "S",
        0,
    ),
    "differences": (
        fh.Wave(fh.Stencil.finite_difference(2), speed=_above(-6.5, 0.6, 1.0), density=_above(-6.5, 0.7, 1.0)),
        (1.0, 1.7),
        "P",
        1,
    ),
    "P in bonds": (_bonds(2.5, young=_above(-6.5, 1.4, 2.0), density=_above(-6.5, 0.3, 0.5)), (1.0, 1.7), "P", 1),
    "S in states": (
        _states(2.0, _above(-6.5, 0.35, 0.25), young=_above(-6.5, 1.5, 2.0), density=_above(-6.5, 0.17, 0.2)),
        (1.0, 1.7),
        "S",
        1,
    ),
    "P in a correspondence material": (
        _states(2.0, _above(-6.5, 0.3, 0.2), young=_above(-6.5, 1.5, 2.0), stabilisation=0.5),
        (1.0, 1.7),
        "P",
        1,
    ),
    "S in space": (
        _bonds(1.5, young=_above(-4.5, 1.5, 2.0), density=_above(-4.5, 0.17, 0.2)),
        (1.0, 0.3, 1.5),
        (-0.3, 1.0, 0.0),
        1,
    ),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if "space" in name else []) for name in _AT_A_SURFACE]
)
def test_with_what_a_surface_sends_back_nothing_leaves_the_box(name):
    _check_that_nothing_leaves_the_box(*_AT_A_SURFACE[name])


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if "space" in name else []) for name in _IN_STRATA]
)
def test_with_what_strata_do_to_the_wave_nothing_leaves_the_box(name):
    _check_that_nothing_leaves_the_box(*_IN_STRATA[name])


def _check_that_nothing_leaves_the_box(model, direction, polarisation, side):
    """Check that the field is the incident wave inside the box, and zero outside; side 0 is no free one."""
    dim = len(direction)
    half = 16 if dim == 2 else 9
    if side:
        lattice, sides = _under_a_surface(half, dim, side)
    else:
        lattice, sides = fh.Lattice(1.0, (-half,) * dim, (half,) * dim), fh.LatticePML(nodes=3)
    sim = fh.Simulation(lattice, model, sides, sources=[fh.IncidentWave(direction, _SIGNAL, _DURATION, polarisation)])
    box = sim.incident[0].wave.within
    assert not side or (box.upper if side > 0 else box.lower)[-1] == 0
    inside, seen = _mask(sim), 0.0
    for t in (30.0, 56.0, 60.0, 64.0, 90.0, 150.0):
        sim.run(until=t)
        incident, u = sim.incident[0].field(sim.time), sim.fields["u"]
        seen = max(seen, np.abs(incident[..., inside]).max())
        left = 10 * sim.incident[0].passage.tail if t > sim.incident[0].passage.period else 0.0
        assert np.abs(u - incident)[..., inside].max() < _EXACT + left
        assert np.abs(u[..., ~inside]).max() < _EXACT + left
    assert seen > 0.8  # a wave has passed
    assert not any("only what is scattered" in note for note in sim.notes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20261127, 20261135))
def test_random_media_and_directions_at_a_surface(seed):
    """Kernel, horizon, calibration, step, side, direction and type of wave are random."""
    rng = np.random.default_rng(seed)
    constants = {"young": 2.0, "density": 0.2, "plane": rng.choice(["strain", "stress"])}
    kernel = {"influence": rng.choice(["constant", "linear"]), "exponent": int(rng.integers(3))}
    kernel = fh.Kernel(float(rng.uniform(1.5, 3.2)), **kernel, calibrate=bool(rng.integers(2)))
    material = rng.choice(["bond-based", "state-based", "correspondence"])
    if material != "bond-based":
        constants |= {"poisson": float(rng.uniform(0.0, 0.4)), "material": material}
    if material == "correspondence":
        constants["stabilisation"] = float(rng.uniform(0.2, 1.0))
    model = fh.Elastic(kernel, **constants) if rng.integers(3) else fh.Wave(kernel)
    side, angle = int(rng.choice([-1, 1])), rng.uniform(-1.4, 1.4)
    direction, signal = (float(np.sin(angle)), side * float(np.cos(angle))), fh.Expression(_SIGNAL.text, 0)
    wave = fh.IncidentWave(direction, signal, _DURATION, rng.choice(["P", "S"]))
    if rng.integers(3) == 0 and type(model) is fh.Elastic:
        wave = fh.RayleighWave((float(rng.choice([-1, 1])), 0.0), signal, _DURATION)
    lattice, sides = _under_a_surface(24 if material == "bond-based" else 40, side=side)
    share = rng.uniform(0.3, 1.8)
    sim = fh.Simulation(lattice, model, sides, sources=[wave], dt=lambda half: share * half)
    inside = _mask(sim)
    for t in (45.0, 60.0, 75.0):
        sim.run(until=t)
        incident, u = sim.incident[0].field(sim.time), sim.fields["u"]
        peak = max(1.0, np.abs(incident).max())
        assert np.abs(u - np.where(inside, incident, 0.0)).max() < _EXACT * peak, f"seed {seed}: {model}, {wave}"


def test_before_the_reflection_comes_the_wave_of_the_open_medium():
    """Below the surface, the wave before the reflection is that of a run without the surface."""
    lattice, sides = _under_a_surface(24)
    wave = fh.IncidentWave((1.0, 2.0), "sin(2*pi*t/16)*exp(-((t-15)/4)**2)", 30.0, within=fh.Box((-16, -20), (16, 0)))
    at_surface = fh.Simulation(lattice, _bonds(2.5), sides, sources=[wave])
    deep = fh.Lattice(1.0, (-24, -24), (24, 12))
    in_the_open = fh.Simulation(deep, _bonds(2.5), fh.LatticePML(nodes=3), sources=[wave])
    found, expected = (run.incident[0].field(12.0)[:, 8:41, 4:14] for run in (at_surface, in_the_open))
    assert np.abs(expected).max() > 0.5
    assert np.abs(found - expected).max() < 1e-4  # the signal is 1e-6 where it is cut off, and so contains short waves


@pytest.mark.parametrize("free", [True, False], ids=["free", "open"])
def test_before_it_comes_to_strata_the_wave_is_that_of_the_open_medium(free):
    """Below strata its signal is where it first meets the box; from above the direction is opposite."""
    up = 1 if free else -1
    lattice = fh.Lattice(1.0, (-24, -24), (24, 0 if free else 24))
    wave = fh.IncidentWave((1.0, 2.0 * up), "sin(2*pi*t/16)*exp(-((t-15)/4)**2)", 30.0)
    sides = {"all": fh.LatticePML(nodes=3)} | ({"y+": fh.Free()} if free else {})
    young = _above(-4.5, 1.0, 2.0) if free else _above(3.5, 2.0, 1.0)
    strata = fh.Simulation(lattice, _bonds(2.5, young=young), sides, sources=[wave])
    box = strata.incident[0].wave.within
    in_the_open = fh.Lattice(1.0, (-24, -24), (24, 24))
    wave = fh.IncidentWave(wave.direction, wave.signal, wave.duration, within=fh.Box(box.lower, (box.upper[0], 20.0)))
    alone = fh.Simulation(in_the_open, _bonds(2.5), fh.LatticePML(nodes=3), sources=[wave])
    rows = slice(4, 12) if free else slice(36, 44)
    found, expected = (run.incident[0].field(12.0)[:, 8:41, rows] for run in (strata, alone))
    assert np.abs(expected).max() > 0.2  # its first part has come
    assert np.abs(found - expected).max() < 1e-4  # the signal is 1e-6 where it is cut off, and so contains short waves


def test_waves_in_strata_that_are_refused():
    """Layers that are not parallel to the surface, and waves along layers."""
    lattice, sides = _under_a_surface(16)
    upright, level = (_bonds(2.5, young=lambda x, y, a=a: np.where((x, y)[a] > -4.5, 1.0, 2.0)) for a in (0, 1))

    def refused(match, model, wave):
        with pytest.raises(fh.InputError, match=match):
            fh.Simulation(lattice, model, sides, sources=[wave])

    refused("not uniform.*parallel to the free side", upright, fh.IncidentWave((1.0, 1.0), _SIGNAL, _DURATION))
    refused(
        "not come to the surface",
        level,
        fh.IncidentWave((1.0, 0.0), _SIGNAL, _DURATION, within=fh.Box((-9, -9), (9, 0))),
    )
    refused("one of a uniform half-space", level, fh.RayleighWave((1.0, 0.0), _SIGNAL, _DURATION))


def test_a_wave_onto_a_wall_is_refused_with_the_reason():
    """The wave inside its box would not account for the wall. A box that ends in front of the wall is accepted, and
    so is one beside absorbing sides if it leaves one reach of the near field.
    """
    lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 0.0))
    wave = {"direction": (1.0, 1.0), "signal": lambda t: np.sin(t / 4) ** 4, "duration": 4 * np.pi}

    def run(side, top, **changes):
        sides = {"all": fh.LatticePML(nodes=8), "y+": side}
        given = fh.IncidentWave(**{**wave, **changes}, within=fh.Box((-6.0, -6.0), (6.0, top)))
        return fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sides, sources=[given])

    for side, tops in ((fh.Fixed(), (0.0, -0.5, 3.0)), (fh.Free(), (-0.5,))):
        for top in tops:
            with pytest.raises(fh.InputError, match="does not account for the surface") as error:
                run(side, top)
            assert error.value.value == "y+" and "source" in error.value.remedy
        sim = run(side, -1.0)
        assert any("only what is scattered meets y+" in note for note in sim.notes)
    with pytest.raises(fh.InputError, match="one reach of the near field must be left"):
        run(fh.LatticePML(nodes=8), 0.0)
    for along in ((1.0, 0.0), (1.0, -0.2)):
        with pytest.raises(fh.InputError, match="does not come to the surface"):
            run(fh.Free(), 0.0, direction=along)


def test_a_corner_of_two_surfaces_is_refused():
    lattice = fh.Lattice(1.0, (-12, -12), (0, 0))
    wave = fh.IncidentWave((1.0, 1.0), _SIGNAL, _DURATION, within=fh.Box((-9, -9), (0, 0)))
    sides = {"all": fh.LatticePML(nodes=8), "x+": fh.Free(), "y+": fh.Free()}
    with pytest.raises(fh.InputError, match="accounts for only one free surface"):
        fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), sides, sources=[wave])


def test_a_crack_from_the_surface_is_inside():
    """The box has no face at the surface: a notch that opens there is accepted, one that runs to another face is
    refused.
    """
    lattice, sides = _under_a_surface(16)
    given = {"sources": [fh.IncidentWave((1.0, 1.0), _SIGNAL, _DURATION)], "boundary": sides}
    fh.Simulation(lattice, _bonds(2.5), cracks=[[(0.5, -4.0), (0.5, 1.0)]], **given)
    with pytest.raises(fh.InputError, match="a crack reaches"):
        fh.Simulation(lattice, _bonds(2.5), cracks=[[(0.5, -9.0), (0.5, 1.0)]], **given)


@pytest.mark.parametrize("constants", [{}, {"poisson": 0.3, "material": "state-based"}], ids=["bonds", "states"])
def test_a_wave_breaks_no_sound_bond_at_the_faces_of_its_box(constants):
    """Across the faces the field jumps by more than the critical stretch, whereas the wave's own strain is at most a
    third of it; inside, the wave breaks bonds beside a crack.
    """
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, critical_stretch=5e-4, **constants)
    lattice, crack = fh.Lattice(1.0, (-22.0, -22.0), (22.0, 22.0)), [[(0.5, -4.0), (0.5, 4.0)]]

    def run(size, cracks=()):
        wave = fh.IncidentWave((1.0, 0.3), f"{size}*exp(-((t - 10)/4)**2)", 20.0)
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=6), sources=[wave], cracks=cracks)
        sim.run(until=40.0)
        return sim

    sound = run(1e-3)
    assert not sound.fields["damage"].any() and not sound.cautions
    broken = run(2e-3, crack).fields["damage"] > run(1e-5, crack).fields["damage"]
    assert broken.any() and not broken[~_mask(sound)].any()


def test_a_surface_wave_breaks_no_sound_bond_at_the_faces_of_its_box():
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, critical_stretch=5e-4)
    wave = fh.RayleighWave((1.0, 0.0), "1e-3*exp(-((t - 25)/7)**2)", 50.0)
    sides = {"all": fh.LatticePML(nodes=6), "y+": fh.Free()}
    sim = fh.Simulation(fh.Lattice(1.0, (-20.0, -30.0), (20.0, 0.0)), model, sides, sources=[wave])
    sim.run(until=45.0)
    assert np.abs(sim.fields["u"]).max() > 5e-4 and not sim.fields["damage"].any()


def test_waves_whose_boxes_are_apart_leave_no_bond_to_break():
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, critical_stretch=5e-4)
    boxes = [fh.Box((x, -10.0), (x + 9.0, 10.0)) for x in (-12.0, 2.0)]
    waves = [fh.IncidentWave((1.0, 0.0), "1e-4*exp(-((t - 10)/4)**2)", 20.0, within=box) for box in boxes]
    lattice = fh.Lattice(1.0, (-16.0, -14.0), (16.0, 14.0))

    def notes(sources):
        return fh.Simulation(lattice, model, fh.LatticePML(nodes=4), sources=sources).notes

    assert any("no node in common" in note for note in notes(waves))
    assert not any("no node in common" in note for note in notes(waves[:1]))


@pytest.mark.parametrize("signal", ["exp(-(t - 3)**2)", fh.Ricker(0.5), lambda t: np.exp(-((t - 3.0) ** 2))])
def test_a_signal_at_many_times_is_that_at_each(signal):
    """Functions in Python are called with one time, others with all of them."""
    wave, times = fh.IncidentWave((1.0, 0.0), signal, 5.0), np.linspace(-1.0, 6.0, 29)
    each = [float(wave.at(t)) for t in times]
    np.testing.assert_allclose(wave.at(times), each, rtol=1e-15)
    assert not np.any(wave.at(times)[(times < 0) | (times > 5.0)]) and np.any(each)


def test_with_nonlinear_bonds_a_part_as_large_as_the_strain_leaves_the_box():
    """The wave is that of the linear medium, as a note says."""
    size, lattice = 5e-2, fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0))
    wave = fh.IncidentWave((1.0, 0.3), f"{size}*exp(-((t - 13)/4)**2)", 26.0)
    left = {}
    for nonlinear in (False, True):
        model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, nonlinear=nonlinear)
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=8), sources=[wave])
        assert any("wave is one of linear bonds" in note for note in sim.notes) == nonlinear
        sim.run(until=40.0)
        left[nonlinear] = np.abs(sim.fields["u"][:, ~_mask(sim)]).max() / size
    strain = size * np.sqrt(2) * np.exp(-0.5) / 4 / model.p_speed
    assert left[False] < 1e-4 < left[True] < strain
