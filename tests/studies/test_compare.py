"""Comparison with the infinite medium: where the edges for comparison lie, and what is measured."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.studies.compare import compare, growth_rate

KERNEL = fh.Kernel(0.5)


def pulse(x, y):
    return np.exp(-8 * (x**2 + y**2))


@pytest.mark.parametrize("edge", ["fixed edge", "free edge"])
def test_the_edge_of_a_disc_is_its_outline(edge):
    """The echo of a pulse in the middle returns along the diagonal as soon as along the axes, so the corners of the
    box do not matter.
    """
    lattice = fh.Lattice(0.25, window=fh.Disc(5.0))
    result = compare({"lattice": lattice, "model": fh.Wave(KERNEL), "initial": {"u": pulse}}, 7.5, shown=7.5)
    assert "outline of the window" in result.table()
    x, y = lattice.coordinates()
    error = np.abs(result.fields[edge] - result.fields["infinite medium"])
    on_diagonal = (np.abs(x - y) < 0.01) & (np.hypot(x, y) > 2) & (np.hypot(x, y) < 4)
    on_axis = (np.abs(y) < 0.01) & (np.hypot(x, y) > 2) & (np.hypot(x, y) < 4)
    assert 0.7 < error[on_diagonal].max() / error[on_axis].max() < 1.4
    assert error[on_axis].max() > 0.02
    assert result.curves["lattice PML"]["error_max_over_run"] < 1e-7


def test_fields_are_kept_while_there_is_something_to_see():
    """The time shown is neither before the echo nor after the pulse has left: both the field and the worst error are
    large.
    """
    setup = {"lattice": fh.Lattice(0.25, (-3, -3), (3, 3)), "model": fh.Wave(KERNEL), "initial": {"u": pulse}}
    result = compare(setup, 20.0)
    number = result.times.index(result.shown_time)
    edge, ours = (result.fields[name] - result.fields["infinite medium"] for name in ("fixed edge", "lattice PML"))
    assert np.abs(edge).max() == result.curves["fixed edge"]["error"][number] > 0.02
    assert np.abs(ours).max() < 1e-7
    assert np.abs(result.fields["infinite medium"]).max() > 0.02


def test_the_edge_of_a_box_is_where_its_layers_were():
    lattice = fh.Lattice(0.25, (-3, -3), (3, 3))
    result = compare(
        {"lattice": lattice, "model": fh.Wave(KERNEL), "initial": {"u": pulse}, "boundary": fh.LatticePML(nodes=12)},
        4.0,
    )
    same = fh.Simulation(lattice, fh.Wave(KERNEL), fh.Fixed(), {"u": pulse})
    same.run(result.shown_time - 1e-9)
    np.testing.assert_array_equal(result.fields["fixed edge"], same.fields["u"])
    assert "absorbing sides" in result.table()
    assert (
        "edge"
        not in compare(
            {"lattice": lattice, "model": fh.Wave(KERNEL), "initial": {"u": pulse}}, 1.0, beside=False
        ).table()
    )


def test_exact_ends_and_layers_stand_beside_each_other():
    """In one dimension, where both can be used, and where the kernel of the exact ends is computed quickly."""
    setup = {
        "lattice": fh.Lattice(0.25, -4, 4),
        "model": fh.Wave(KERNEL),
        "initial": {"u": lambda x: np.exp(-8 * x**2)},
    }
    for boundary, first in (
        (fh.Exact(), "exact"),
        (fh.LatticePML(), "lattice PML"),
        ({"x-": fh.Exact(), "x+": fh.Free()}, "exact"),
    ):
        result = compare({**setup, "boundary": boundary}, 10.0)
        assert next(iter(result.curves)) == first and {"exact", "lattice PML"} <= set(result.curves)
        assert result.curves["exact"]["error_max_over_run"] < 1e-11
        assert 0 < result.curves["lattice PML"]["error_max_over_run"] < 1e-6
    rk4 = {**setup, "model": fh.Diffusion(KERNEL, integrator="rk4")}
    assert "exact" not in compare({**rk4, "boundary": fh.LatticePML()}, 1.0).curves


def test_prescribed_nodes():
    """Points and masks are found again on the extended domain; errors are relative to the largest value of the run."""
    lattice = fh.Lattice(0.25, -4, 4)
    for where in ([0.5], np.arange(33) == 18):
        result = compare(
            {
                "lattice": lattice,
                "model": fh.Wave(KERNEL),
                "boundary": fh.Exact(),
                "constraints": [fh.Prescribed(where, np.sin, 4.0)],
            },
            10.0,
        )
        assert result.curves["exact"]["error_max_over_run"] < 1e-11 and result.scale == "largest value of the run"


def test_a_run_at_rest_is_not_compared():
    """There is no value to which errors could be relative, for example when a source begins later."""
    late = fh.Source(lambda x: np.exp(-8 * x**2), lambda t: max(t - 5.0, 0.0))
    setup = {"lattice": fh.Lattice(0.25, -4, 4), "model": fh.Wave(KERNEL), "boundary": fh.Fixed(), "sources": [late]}
    with pytest.raises(fh.InputError, match=r"times: nothing moves .*value: to t = .*remedy: later times"):
        compare(setup, 1.0)


def test_a_solid_that_heats_as_it_is_deformed_has_no_infinite_medium():
    solid = fh.Thermoelastic(
        fh.Elastic(fh.Kernel(1.0, 1, "linear"), 1.0), fh.Heat(fh.Kernel(1.0, 1), conductivity=0.1), 0.01, 1.0
    )
    setup = {"lattice": fh.Lattice(0.5, (-4, -4), (4, 4)), "model": solid, "boundary": fh.LatticePML(nodes=4)}
    warm = {"T": lambda x, y: 1 + np.exp(-2 * (x**2 + y**2))}
    with pytest.raises(fh.InputError, match=r"model\.coupled: .*for one field.*remedy: false"):
        compare({**setup, "initial": warm}, 1.0)


def test_growth_rate_of_an_exponential():
    """Fitted over the second half: earlier values do not count, and gaps and zeros are left out."""
    times = np.linspace(0, 10, 21)
    values = np.where(times < 5, 7.0, 1e-9 * np.exp(1.3 * times))
    values[15] = 0.0
    assert growth_rate(times, values) == pytest.approx(1.3)
    assert growth_rate([1.0], [1.0]) == 0


def test_growth_is_measured_with_backward_waves_only():
    setup = {"lattice": fh.Lattice(0.25, -3, 3), "initial": {"u": lambda x: np.exp(-8 * x**2)}}
    undamped = {"boundary": fh.LatticePML(nodes=12, profile={"sigma": np.linspace(0.5, 12, 13), "alpha": 0.004})}
    # four crossings: only the fastest growing mode is left
    with_them = compare({**setup, **undamped, "model": fh.Wave(fh.Kernel(0.75, 0))}, 24.0)
    assert with_them.growth["lattice PML"] < with_them.growth_bound and "backward waves grow" in with_them.table()
    assert compare({**setup, **undamped, "model": fh.Wave(fh.Kernel(0.75, 2))}, 8.0).growth == {}
    assert compare({**setup, "model": fh.Wave(fh.Kernel(0.75, 0))}, 8.0).growth == {}  # damped


def test_exact_ends_that_are_left_out_are_named(monkeypatch):
    """Beside a layer in one dimension exact ends are run, or the table says why not."""
    setup = {
        "lattice": fh.Lattice(0.25, -3, 3),
        "model": fh.Wave(KERNEL),
        "initial": {"u": lambda x: np.exp(-8 * x**2)},
    }
    assert "left out" not in compare(setup, 1.0).table()
    monkeypatch.setattr("farhorizon.studies.compare._KERNEL", 1.0)
    result = compare(setup, 1.0)
    assert "left out: exact ends" in result.table() and not any("exact" in name for name in result.curves)


def test_a_body_given_as_arrays_is_compared_as_one_given_by_functions():
    """Initial data, forces and the material continue into the larger body; the fixed edge is exact until the wave
    returns from it.
    """
    lattice = fh.Lattice(1.0, (-12.0, -9.0), (12.0, 9.0))
    x, y = lattice.coordinates()

    def bump(x, y):
        return np.where(x**2 + y**2 < 25, np.exp(-(x**2) - y**2), 0.0)

    def young(x, y):
        return np.where(y > 2, 0.5, 1.0)

    def setup(bump, young):
        return {
            "lattice": lattice,
            "model": fh.Correspondence(fh.Kernel(3.0, 0, "gaussian"), young, 0.25, drag=0.1),
            "initial": {"u": [bump, 0.0]},
            "boundary": {"x": fh.NonlocalPML(8), "y-": fh.Free(), "y+": fh.Fixed()},
            "loads": [fh.BodyForce([bump, 0.0])],
        }

    one, other = (
        compare(setup(*given), 30.0, [3.0, 30.0]).curves for given in ((bump, young), (bump(x, y), young(x, y)))
    )
    for name, curve in one.items():
        assert curve["error"] == pytest.approx(other[name]["error"], rel=1e-9, abs=1e-14)
    assert one["nonlocal PML"]["error"][1] < 0.1 * one["fixed edge"]["error"][1]
    assert one["fixed edge"]["error"][0] < 1e-6 * one["fixed edge"]["error"][1]
