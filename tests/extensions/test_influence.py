"""Influence functions defined by users: the one of docs/extending.md, and the built-in ones written as functions."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate

import farhorizon as fh

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
OURS = {
    "constant": np.ones_like,
    "linear": lambda r: np.maximum(1 - r, 0),
    "gaussian": lambda r: np.exp(-((3 * r) ** 2)),
}


def bump():
    """Return the function as it is on the page."""
    module = {}
    exec(re.search(r"```python\n([^`]*def bump.*?)```", PAGE, re.S).group(1), module)
    return module["bump"]


@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("exponent", [0, 1, 2])
def test_ours_as_functions(name, dim, exponent):
    """The same constants, stencils and dispersion as from the closed forms."""
    named, given = (fh.Kernel(3.5, exponent, influence=one) for one in (name, OURS[name]))
    assert given.scaling_constant(dim) == pytest.approx(named.scaling_constant(dim), rel=1e-12)
    k = np.linspace(0.0, 4.0, 9)
    assert given.dispersion(k, dim) == pytest.approx(named.dispersion(k, dim), rel=1e-9, abs=1e-9)
    mine, theirs = (kernel_stencil(one, dim) for one in (given, named))
    assert np.array_equal(mine.offsets, theirs.offsets)
    assert mine.weights == pytest.approx(theirs.weights, rel=1e-12)


def kernel_stencil(kernel, dim):
    return fh.Stencil.from_kernel(kernel, 1.0, dim)


@pytest.mark.parametrize("dim", [1, 2])
def test_the_operator_tends_to_the_laplacian(dim):
    """Moments agree with adaptive quadrature of scipy, and long waves have the symbol k^2."""
    kernel = fh.Kernel(4.0, 1, influence=bump())
    moment = integrate.quad(lambda r: float(bump()(np.array(r))) * r**dim, 0, 1)[0] * 4.0 ** (dim + 1)
    sphere = {1: 2.0, 2: 2 * np.pi}[dim]
    assert kernel.scaling_constant(dim) == pytest.approx(2 * dim / (sphere * moment), rel=1e-9)
    assert kernel.dispersion(1e-3, dim) == pytest.approx(1e-6, rel=1e-4)
    errors = []
    for spacing in (1.0, 0.5, 0.25):
        stencil = fh.Stencil.from_kernel(kernel, spacing, dim)
        k = np.zeros((1, dim))
        k[0, 0] = 1.0
        lattice = (stencil.weights * (1 - np.cos(stencil.offsets @ k[0] * spacing))).sum() / spacing**2
        errors.append(abs(lattice - float(kernel.dispersion(1.0, dim))))
    assert errors[-1] < errors[0] / 16  # second order in the spacing, horizon fixed


def test_a_run_stays_as_in_the_infinite_medium():
    """Layers, certificate and reference follow from the stencil."""
    lattice = fh.Lattice(1.0, (-15.0, -12.0), (15.0, 12.0))
    pulse = {"u": "exp(-(x**2 + y**2)/6)"}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0, 1, influence=bump())), initial=pulse, threads=1)
    assert sim.certificate().verdict == "certified"
    from farhorizon.studies.compare import compare

    setup = {"lattice": lattice, "model": sim.model, "boundary": fh.LatticePML(target=1e-4), "initial": pulse}
    assert max(compare(setup, 60.0, beside=False).curves["lattice PML"]["error_rel_initial"]) < 1e-4


@pytest.mark.parametrize(
    ("influence", "message"),
    [
        (lambda r: 1 - 2 * r, "not negative"),
        (lambda r: 0 * r, "not zero everywhere"),
        (lambda r: 1.0, "one value a distance"),
        (lambda r: np.log(r * 0), "finite"),
        (7, "unknown influence function|must be"),
    ],
)
def test_what_is_refused(influence, message):
    with pytest.raises(fh.InputError, match=message), np.errstate(all="ignore"):
        fh.Kernel(3.0, influence=influence)


def test_a_checkpoint_asks_for_the_model(tmp_path):
    model = fh.Wave(fh.Kernel(2.0, influence=OURS["linear"]))
    sim = fh.Simulation(fh.Lattice(1.0, -9, 9), model, initial={"u": "exp(-x**2/2)"}, threads=1)
    sim.step(5)
    sim.save(tmp_path / "state.npz")
    with pytest.raises(fh.InputError, match="a checkpoint cannot hold a Python function"):
        fh.Simulation.restore(tmp_path / "state.npz")
    again = fh.Simulation.restore(tmp_path / "state.npz", model=model)
    assert np.array_equal(again.fields["u"], sim.fields["u"])
