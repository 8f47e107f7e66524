"""Orders of convergence of known laws, of a case file and of runs; what is refused."""

import numpy as np
import pytest

import farhorizon as fh

SPACINGS = [0.1, 0.4, 0.2]
CASE = """
lattice = { spacing = 0.5, lower = [-8.0, -8.0], upper = [8.0, 8.0] }
model = { type = "wave", kernel = { horizon = 1.0 } }
initial = { u = "exp(-(x**2 + y**2)/2)" }
boundary = { all = { type = "fixed" } }
run = { until = 2.0 }
"""


@pytest.mark.parametrize("order", [1.0, 2.0, 3.5])
def test_the_order_of_a_power_law(order):
    """Exact with and without exact values, for numbers and arrays; approximate with more spacings and another term."""
    for value in (2.0, np.array([1.0, -3.0])):
        found = fh.convergence(lambda h: h, SPACINGS, lambda h, value=value: value + value * h**order, exact=value)
        assert found.order == pytest.approx(order) and list(found.spacings) == [0.4, 0.2, 0.1]
        fitted = fh.convergence(lambda h: h, SPACINGS, lambda h, value=value: value + value * h**order)
        assert fitted.order == pytest.approx(order, abs=1e-5)
        np.testing.assert_allclose(fitted.limit, value, rtol=1e-5)
        np.testing.assert_allclose(fitted.errors, found.errors, rtol=1e-3)
    more = fh.convergence(lambda h: h, [0.2, 0.1, 0.05, 0.025], lambda h: 1 + h**order * (1 + 0.1 * h))
    assert more.order == pytest.approx(order, abs=0.05) and more.limit == pytest.approx(1, abs=1e-3)


def test_a_case_file_is_refined(tmp_path):
    """With a horizon of two spacings at each spacing, waves are of second order, with and without exact values."""
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    case = fh.read_case(path)
    finer = case.refined(0.25)
    assert finer.lattice.spacing == 0.25 and finer.parts.model.kernel.horizon == 0.5 and finer.end == case.end

    def at_three(run):
        assert run.stencil.reach == (2, 2) and run.time == 2.0
        stride = round(1 / run.lattice.spacing)
        return run.fields["u"][::stride, ::stride][6:11, 8]

    found = fh.convergence(case, [0.5, 0.25, 0.125], at_three)
    assert found.order == pytest.approx(2, abs=0.15), str(found)
    known = fh.convergence(case, [0.5, 0.25], at_three, exact=found.limit)
    np.testing.assert_allclose(known.errors, found.errors[:2], rtol=1e-12)
    found.plot(tmp_path / "order.png")
    assert (tmp_path / "order.png").stat().st_size > 1000 and str(found).count("\n") == 4


def test_a_step_of_its_own_is_refined_with_the_spacing(tmp_path):
    """As stability requires: with the square of the spacing where something diffuses."""
    for text, factor in ((CASE, 0.5), (CASE.replace("wave", "diffusion"), 0.25)):
        (tmp_path / "case.toml").write_text(text.replace("until = 2.0", "until = 2.0, dt = 0.02"))
        case = fh.read_case(tmp_path / "case.toml")
        assert case.refined(0.25).parts.run.dt == pytest.approx(0.02 * factor)


@pytest.mark.parametrize(
    ("spacings", "quantity", "exact", "message"),
    [
        ([0.1], lambda h: h, 0.0, "2 or more"),
        ([0.2, 0.1], lambda h: h, None, "3 or more"),
        ([0.2, 0.1, 0.1], lambda h: h, None, "different"),
        ([0.2, 0.1, -0.1], lambda h: h, None, "positive"),
        (SPACINGS, lambda h: np.zeros(round(1 / h)), None, "one shape"),
        (SPACINGS, lambda h: np.nan, None, "finite"),
        (SPACINGS, lambda h: 1.0, 1.0, "without any error"),
        (SPACINGS, lambda h: 1.0, None, "without any error"),
        (SPACINGS, lambda h: 1 / h, None, "no nearer to a limit"),
        (SPACINGS, lambda h: h == 0.2, None, "no nearer to a limit"),
        (SPACINGS, 3.0, None, "quantity"),
    ],
)
def test_refused(spacings, quantity, exact, message):
    with pytest.raises(fh.InputError, match=message):
        fh.convergence(lambda h: h, spacings, quantity, exact)
