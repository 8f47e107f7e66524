"""Reflection of flat sides by conditions along an outline, and the search for the best certified setting."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.papers import hermann2023
from farhorizon.studies import tuning
from farhorizon.studies.tuning import flat_reflection

WAVENUMBERS = (0.15, 0.3, 0.6, 1.0, 1.5, 2.0)
SHARP = {"angle": 60.0, "wavenumber": 2.0, "radius": 0.75, "regularization": 4e-5}  # a fit that is hardly regularised
MEDIA = {
    "horizon 3 spacings": fh.Wave(fh.Kernel(0.75, 2), damping=0.0125),
    "horizon 6 spacings": fh.Wave(fh.Kernel(1.5, 2), damping=0.0125),
    "finite differences": fh.Wave(fh.Stencil.finite_difference(2)),
}


def disc(boundary, model=MEDIA["horizon 3 spacings"], radius=7.37, **options):
    """A disc without single nodes at its poles."""
    return fh.Simulation(fh.Lattice(0.25, window=fh.Disc(radius)), model, boundary, dt=0.05, **options)


@pytest.mark.parametrize(
    "boundary, found",
    [
        (fh.PlaneWave(**SHARP), (0.0017, 0.0025)),
        (hermann2023.published(0.75, normals="lattice"), (0.0029, 0.024)),
        (fh.Higdon((0, 45), 0.02), (0.0064, 0.059)),
    ],
)
def test_flat_reflection_by_other_programs(boundary, found):
    """Largest reflection over the wavenumbers above at 0 and 60 degrees, as found by an independent program for a
    kernel that is not calibrated.
    """
    sim = disc(boundary, fh.Wave(fh.Kernel(0.75, 2, calibrate=False), damping=0.0125))
    bands = [(2 * np.pi / k, 2 * np.pi / k * (1 + 1e-9)) for k in WAVENUMBERS]
    head_on = max(flat_reflection(sim, boundary, 0.0, band) for band in bands)
    up_to_60 = max(flat_reflection(sim, boundary, 60.0, band) for band in bands)
    assert head_on == pytest.approx(found[0], rel=0.25)
    assert up_to_60 == pytest.approx(found[1], rel=0.1)


@pytest.mark.parametrize("angles", [(0.0,), (0.0, 45.0), (30.0, 60.0)])
def test_flat_reflection_of_long_waves_by_higdon(angles):
    """The product of (cos a - cos b)/(cos a + cos b) over the angles a of Higdon's condition at incidence b, here for
    b up to 20 degrees.
    """
    boundary = fh.Higdon(angles, 0.0)
    sim = disc(boundary, MEDIA["finite differences"])
    at = np.cos(np.radians(np.linspace(0, 20, 5)))
    exact = max(
        np.prod([(np.cos(np.radians(a)) - c) / (np.cos(np.radians(a)) + c) for a in angles]).__abs__() for c in at
    )
    assert flat_reflection(sim, boundary, 20.0, (100.0, 200.0)) == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("name", MEDIA)
def test_the_fit_does_not_depend_on_a_small_regularization(name):
    """From 1e-7 to 1e-4 the reflection is the same."""
    found = [
        flat_reflection(disc(boundary, MEDIA[name]), boundary, 60.0, (3.0, 30.0))
        for boundary in (fh.PlaneWave(**SHARP | {"regularization": r}) for r in (4e-5, 1e-7, 1e-4))
    ]
    np.testing.assert_allclose(found, found[0], rtol=1e-3)


def test_tuned():
    """In the damped medium the best setting for a small disc is certified and reflects no more than the default, and
    the boundary is certified again in a new simulation.
    """
    sim = disc(fh.PlaneWave(), radius=5.12)
    found = fh.tuned(sim, band=(3.0, 30.0))
    assert found.certificate.verdict == "certified"
    assert found.amplitude <= flat_reflection(sim, fh.PlaneWave(), 60.0, (3.0, 30.0))
    assert sim.remade(boundary=found.boundary).certificate().verdict == "certified"
    assert "degrees" in str(found) and found.toml.startswith('{ type = "plane-wave", radius = ')


def test_undamped_media():
    """Without damping, clouds of 3 spacings grow; the report says so and what to do."""
    start = {"u": lambda x, y: np.exp(-4 * (x**2 + y**2))}
    sim = disc(fh.PlaneWave(**SHARP), fh.Wave(fh.Kernel(0.75, 2)), radius=5.12, initial=start)
    report = sim.check()
    assert report.certificate.verdict == "not certified"
    assert "Higdon(angles=(0, 45))" in report.warnings[0] and "--tune" in report.warnings[0]
    assert "Use PlaneWave() without options" in report.warnings[0]
    assert sim.remade(boundary=fh.Higdon(shift=0.02)).certificate().verdict == "certified"


def test_what_is_not_tuned():
    """Layers, and diffusion."""
    for sim in (
        disc(fh.LatticePML(nodes=8)),
        fh.Simulation(fh.Lattice(0.25, window=fh.Disc(3.0)), fh.Diffusion(fh.Kernel(0.5)), fh.PlaneWave()),
    ):
        with pytest.raises(fh.InputError, match="PlaneWave or Higdon"):
            fh.tuned(sim)


@pytest.mark.parametrize("wrong", [{"angle": 90.0}, {"band": (30.0, 3.0)}, {"band": (-3.0, 3.0)}, {"budget": 0.0}])
def test_numbers_out_of_range(wrong):
    with pytest.raises(fh.InputError, match=next(iter(wrong))):
        fh.tuned(disc(fh.PlaneWave(), radius=3.1), **wrong)


def test_nothing_certified(monkeypatch):
    """In space, with clouds of several spacings only, the error says what to do."""
    monkeypatch.setattr(tuning, "_RADII", (3.0,))
    model = fh.Wave(fh.Kernel(0.5, 2, influence="linear"), damping=0.0125)
    sim = fh.Simulation(fh.Lattice(0.25, window=fh.Ball(1.62)), model, fh.PlaneWave(cone=30.0, angles=5), dt=0.05)
    with pytest.raises(fh.InputError, match=r"no setting is certified.*Higdon"):
        fh.tuned(sim, band=(3.0, 30.0), budget=5.0)
