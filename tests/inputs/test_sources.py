"""Sources: how they separate into space and time, their effect on a run, and what is refused."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon import (
    Diffusion,
    Disc,
    Elastic,
    Expression,
    Free,
    InputError,
    Kernel,
    Lattice,
    LatticePML,
    Simulation,
    Source,
    Wave,
)
from farhorizon.inputs.sources import at_times, checked, space_and_time, split
from helpers import kernel_stencil, lattice_of

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))

LATTICE = lattice_of((9, 11), 0.5)
X, Y = LATTICE.coordinates()
SHAPE = np.exp(-((X - 2) ** 2) - (Y - 2) ** 2)


def value_of(source, t):
    """Return the source at time t as an array."""
    space, time = split(source, LATTICE)
    return np.broadcast_to(time(t) if space is None else space * time(t), LATTICE.shape)


WAYS = {
    "array and time": (Source(SHAPE, lambda t: np.sin(3 * t)), True),
    "callable and time": (Source(lambda x, y: np.exp(-((x - 2) ** 2) - (y - 2) ** 2), lambda t: np.sin(3 * t)), True),
    "callable of x, y, t": (Source(lambda x, y, t: np.exp(-((x - 2) ** 2) - (y - 2) ** 2) * np.sin(3 * t)), False),
    "bare callable": (lambda x, y, t: np.exp(-((x - 2) ** 2) - (y - 2) ** 2) * np.sin(3 * t), False),
    "expression": (Expression("exp(-(x-2)**2-(y-2)**2)*sin(3*t)", 2), True),
    "expression that does not split": (Expression("exp(-(x-2)**2-(y-2)**2 + 0*t)*sin(3*t)", 2), False),
    "expression and time": (Source(Expression("exp(-(x-2)**2-(y-2)**2)", 2), lambda t: np.sin(3 * t)), True),
    "expression of t and time": (
        Source(Expression("exp(-(x-2)**2-(y-2)**2)*t", 2), lambda t: np.sin(3 * t) / t if t else 3.0),
        True,
    ),
}


@pytest.mark.parametrize(("source", "separable"), WAYS.values(), ids=WAYS)
def test_ways_to_write_a_source(source, separable):
    """All give exp(-r^2) sin(3 t) around (2, 2); products of space and time are recognised."""
    assert (split(source, LATTICE)[0] is not None) == separable
    for t in (0.1, 0.7, 2.0):
        np.testing.assert_allclose(value_of(source, t), SHAPE * np.sin(3 * t), atol=1e-15)


def test_constant_sources():
    """Numbers and arrays act at all times."""
    np.testing.assert_array_equal(value_of(2.5, 7.0), 2.5)
    np.testing.assert_array_equal(value_of(SHAPE, 7.0), SHAPE)


@pytest.mark.parametrize(
    "make", [Wave, Diffusion, lambda s: Diffusion(s, integrator="rk4")], ids=["Verlet", "Euler", "RK4"]
)
def test_every_way_runs_alike(make):
    """A table of amplitudes in the compiled loop and a call in every step give the same field."""
    results = []
    for source, _ in list(WAYS.values())[:6]:
        sim = Simulation(LATTICE, make(kernel_stencil(2, 2)), Free(), sources=[source])
        sim.step(30)
        results.append(sim.fields["u"])
    assert np.abs(results[0]).max() > 0.01
    for other in results[1:]:
        np.testing.assert_allclose(other, results[0], rtol=0, atol=1e-14)


def test_sources_superpose():
    """The field is linear in its sources, including mixed kinds."""
    kinds = [WAYS["array and time"][0], WAYS["bare callable"][0], Source(np.roll(SHAPE, 2, 0), lambda t: np.cos(t))]
    fields = []
    for sources in (*[[s] for s in kinds], kinds):
        sim = Simulation(LATTICE, Wave(kernel_stencil(2, 2)), Free(), sources=sources)
        sim.step(40)
        fields.append(sim.fields["u"])
    np.testing.assert_allclose(fields[3], fields[0] + fields[1] + fields[2], rtol=0, atol=1e-13)


def test_a_uniform_source_fills_an_insulated_body():
    """The content grows by the integral of the source: sum u = N (1 - cos(w t)) / w for sin(w t), to the order of
    RK4.
    """
    sim = Simulation(
        LATTICE,
        Diffusion(kernel_stencil(2, 2), 0.4, "rk4"),
        Free(),
        sources=[Source(1.0, lambda t: np.sin(2 * t))],
        dt=0.01,
    )
    sim.run(1.0)
    np.testing.assert_allclose(sim.fields["u"], (1 - np.cos(2.0)) / 2, rtol=1e-9)


def test_a_constant_force_accelerates_a_free_body():
    """u = a t^2 / 2, which is exact for velocity Verlet."""
    sim = Simulation(LATTICE, Wave(kernel_stencil(2, 2)), Free(), sources=[3.0])
    sim.step(50)
    np.testing.assert_allclose(sim.fields["u"], 1.5 * sim.time**2, rtol=1e-12)


def test_source_in_an_unbounded_medium_in_1d():
    """A point force spreads at the wave speed c: the displacement behind the front is 1 / (2 c) per unit impulse.

    For u_tt = u_xx + f delta(x): u = f/2 (t - |x|) behind the front (d'Alembert), here at nodes that the front passed
    long ago.
    """
    lattice = Lattice(0.1, lower=-4, upper=4)
    point = np.where(np.abs(lattice.coordinates()[0]) < 1e-9, 1 / 0.1, 0.0)
    smooth = lambda t: np.sin(np.pi * t / 2) ** 2 if t < 2 else 0.0  # noqa: E731, impulse 1, ends at t = 2
    sim = Simulation(lattice, Wave(kernel_stencil(1, 1)), LatticePML(), sources=[Source(point, smooth)])
    sim.run(8.0)
    # dispersion of order (pi dx / c T)^2 / 24, and the drift due to the shift alpha
    np.testing.assert_allclose(sim.fields["u"], 0.5, rtol=2e-3)


# What is refused


def test_wrong_shapes_and_values():
    """Arrays of another shape, nan and inf."""
    with pytest.raises(InputError, match="lattice's shape"):
        split(np.zeros((3, 3)), LATTICE)
    with pytest.raises(InputError, match="lattice's shape"):
        value_of(lambda x, y, t: np.zeros(4), 0.0)
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match="finite"):
            split(np.where(X > 1, bad, 0.0), LATTICE)


def test_masked_entries_are_refused():
    """Masked entries have no values, whatever is stored below the mask."""
    masked = np.ma.array(np.ones(LATTICE.shape), mask=X > 1)
    for given in ({"initial": {"u": masked}}, {"sources": [masked]}, {"coefficient": masked}):
        with pytest.raises(InputError, match=f"entries are masked.*value: {(X > 1).sum()} of {X.size}.*filled"):
            Simulation(LATTICE, Wave(kernel_stencil(2, 2)), Free(), **given)
    whole = np.ma.array(np.ones(LATTICE.shape), mask=False)
    assert (Simulation(LATTICE, Wave(kernel_stencil(2, 2)), Free(), {"u": whole}).fields["u"] == 1).all()


@pytest.mark.parametrize(
    "source", [Source(1.0, lambda t: np.nan if t > 1 else 1.0), lambda x, y, t: x * (np.nan if t > 1 else 1.0)]
)
def test_a_source_that_becomes_nan_stops_the_run(source):
    """The run stops before the value enters the field."""
    sim = Simulation(LATTICE, Wave(kernel_stencil(2, 2)), Free(), sources=[source])
    with pytest.raises(InputError, match=r"source.*finite"):
        sim.run(3.0)
    assert np.isfinite(sim.fields["u"]).all()


@pytest.mark.parametrize("time", ["sqrt(2-t)", lambda t: np.sqrt(2 - t) if t <= 2 else np.nan])
def test_the_time_at_which_a_factor_is_not_finite_is_told(time):
    """The error names the first step beyond 2, though many steps are tabulated at once."""
    sim = Simulation(LATTICE, Wave(kernel_stencil(2, 2)), Free(), sources=[Source(SHAPE, time)])
    first = sim.dt * (np.floor(2 / sim.dt) + 1)
    with pytest.raises(InputError, match=f"source: .* is not finite; value: t = {first:g}; limit: no nan"):
        sim.run(40.0)


def test_what_is_not_finite_beyond_a_side_is_told_as_that():
    source = lambda x, y, t: np.exp(-(x**2) - y**2) * (np.nan if t > 2 else 1.0)  # noqa: E731
    sim = Simulation(LATTICE, Wave(kernel_stencil(2, 2)), LatticePML(), sources=[source])
    with pytest.raises(InputError, match=r"source: not finite beyond the absorbing side x-.*value: nan at \["):
        sim.run(4.0)


def test_values_outside_a_body_do_not_count():
    """Values may be nan where there is no node, and are zero there."""
    lattice = Lattice(0.5, lower=(-3, -3), upper=(3, 3), body=Disc(2))
    values = checked(np.where(lattice.mask, 1.0, np.nan), lattice)
    np.testing.assert_array_equal(values, lattice.mask)


def test_values_outside_a_window_are_zero_where_not_finite():
    """The fields of a simulation (nan outside its window) can start another one."""
    lattice = Lattice(0.5, window=Disc(4))
    values = checked(np.where(lattice.mask, 1.0, np.nan), lattice)
    np.testing.assert_array_equal(values, lattice.mask)


def test_a_component_left_at_zero_is_no_source():
    """A zero component gives neither a note nor a source; if all components are zero there is a note."""
    lattice = Lattice(1.0, (-6, -6), (6, 6))
    model = Elastic(Kernel(1.5), young=1.0)
    push = Expression("exp(-x**2-y**2)", 2)
    for nothing in (0.0, 0, Expression("0", 2)):
        sim = Simulation(lattice, model, sources=[[nothing, push]])
        assert len(sim.sources) == 1 and not any("zero on every node" in note for note in sim.notes)
        assert any(
            "zero on every node" in note for note in Simulation(lattice, model, sources=[[nothing, nothing]]).notes
        )


def test_data_whose_squares_overflow_are_refused():
    lattice = Lattice(1.0, (-8.0,), (8.0,))
    with pytest.raises(InputError, match=r"initial.u: .*overflow; value: 1e[+]?300; limit: 1e[+]?150"):
        Simulation(lattice, Wave(Kernel(2.0)), Free(), {"u": 1e300})
    sim = Simulation(lattice, Wave(Kernel(2.0)), Free(), {"u": lambda x: 1e150 * np.exp(-(x**2))})
    sim.step(20)
    assert np.isfinite(sim.energy())


FACTORS = {
    "signal": fh.Ricker(0.3),
    "burst": fh.ToneBurst(0.4, 5),
    "expression": fh.Expression("where(t < 3, sin(2*t)*exp(-t), t**3/7)").on(0),
    "product": space_and_time(fh.Source("x*cos(t)", fh.Ricker(0.3)))[1],
    "function": lambda t: float(np.sin(t)),
}


@pytest.mark.parametrize("time", FACTORS.values(), ids=FACTORS)
def test_factors_at_many_times_are_those_at_each_and_in_other_batches(time):
    """The latter to the last bit, because a run that is resumed makes its steps in other batches."""
    print(f"seed {SEED}")
    times = np.random.default_rng(SEED).uniform(0, 12, 300)
    together = at_times(time, times)
    np.testing.assert_allclose(together, [time(t) for t in times], rtol=1e-14, atol=1e-15)
    for cut in (1, 7, 8, 131):
        pieces = [at_times(time, part) for part in np.split(times, np.arange(cut, times.size, cut))]
        np.testing.assert_array_equal(np.concatenate(pieces), together)


def test_a_factor_that_returns_more_than_one_number_is_refused():
    with pytest.raises(fh.InputError, match=r"source\.time"):
        at_times(lambda t: np.array([t, t]), np.arange(3.0))
