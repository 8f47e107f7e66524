"""The energy at which a crack at rest begins to grow, and critical stretches calibrated by it."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.simulation.setup import crack_calibration
from farhorizon.simulation.setup.crack_calibration import energies_at_rest

PLATE = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0))
FACTORS = {"_energy_factor": 0.8, "_static_factor": 0.9}


@pytest.fixture
def factors(monkeypatch, tmp_path):
    """Factors in place of those of cracks that are run; nothing is known beforehand."""
    for name, factor in FACTORS.items():
        monkeypatch.setattr(crack_calibration, name, lambda runs, model, dim, factor=factor: factor)
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))


def stretch_of(energy, factor, young=2.0, horizon=1.0):
    return np.sqrt(energy / (factor * young * horizon))


@pytest.mark.parametrize("options", [{}, {"material": "state-based", "poisson": 0.3}], ids=["bonds", "states"])
def test_a_crack_at_rest_takes_the_fracture_energy(options, factors):
    """And the note says what one that runs takes of it."""
    given = {"kernel": fh.Kernel(1.0, 1), "young": 2.0, "fracture_energy": 1e-4, **options}
    static = fh.Simulation(PLATE, fh.Elastic(calibrate="static", **given), fh.Free())
    expected = stretch_of(1e-4, 0.9)
    assert static.engine.bonds.critical_stretches == pytest.approx((expected,) * 2, rel=1e-12)
    assert fh.calibrated_stretch(fh.Elastic(**given), 0.5, 1e-4, calibrate="static") == pytest.approx(expected)
    (note,) = [note for note in static.notes if "fracture energy" in note]
    assert "at rest" in note and f"dissipates {0.8 / 0.9:.3g} of it" in note
    running = fh.Simulation(PLATE, fh.Elastic(**given), fh.Free())
    assert any('calibrate = "static"' in note for note in running.notes)
    again = fh.Simulation.of(static.settled)
    assert again.engine.bonds.critical_stretches == static.engine.bonds.critical_stretches


def at_rest(nodes, stretch, dim=2):
    """Energies over what bonds across a plane store, for a number of nodes in the horizon."""
    of_bonds = nodes * stretch**2 * (12 / (5 * np.pi) if dim == 2 else 6 / 5)
    model = fh.Elastic(fh.Kernel(nodes, 1), 1.0, critical_stretch=stretch, plane="stress" if dim == 2 else None)
    return np.array(energies_at_rest(fh.Simulation.of, model, dim, of_bonds)) / of_bonds


def test_the_energy_is_that_of_linear_bonds():
    """It is proportional to the square of the critical stretch."""
    np.testing.assert_allclose(at_rest(2.0, 0.01), at_rest(2.0, 0.02), rtol=1e-6)


@pytest.mark.slow
def test_tips_wait_less_on_finer_lattices():
    """With 2, 3 and 4 nodes in the horizon; also in space, in plane strain."""
    for dim, nodes in ((2, (2.0, 3.0)), (3, (2.0, 3.0))):
        first, grown = np.transpose([at_rest(n, 0.01, dim) for n in nodes])
        print(dim, first, grown)
        assert (first <= grown).all() and grown[0] > grown[1] > 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "least", "most"),
    [
        ({}, 1.05, 1.17),
        ({"material": "state-based", "poisson": 0.3}, 1.05, 1.17),
        ({"material": "correspondence", "poisson": 0.3, "stabilisation": 0.4}, 1.05, 1.37),
    ],
)
def test_a_crack_at_rest_takes_more_than_one_that_runs(options, least, most):
    """The ranges of slowly pulled strips and double cantilever beams, see `simulation.time.breaking.AT_REST`."""
    model = fh.Elastic(fh.Kernel(3.0, 1), 1.0, plane="stress", **options)
    running, static = (fh.calibrated_stretch(model, 1.0, 1e-6, calibrate=name) for name in ("running", "static"))
    print(options, (running / static) ** 2)
    assert least < (running / static) ** 2 < most


@pytest.mark.parametrize(
    "options",
    [{"critical_stretch": 0.01}, {"fracture_energy": 1.0, "critical_stretch": 0.01, "softening": "linear"}, {}],
)
def test_bad_input(options):
    with pytest.raises(fh.InputError, match=r"model\.calibrate"):
        fh.Elastic(fh.Kernel(2.0), 1.0, calibrate="static", **options)
