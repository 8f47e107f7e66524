"""Stresses at points of heated solids: those that are free are not stressed, and those that are held are."""

import numpy as np
import pytest

import farhorizon as fh

MATERIALS = {
    "bond-based": {},
    "state-based": {"poisson": 0.3},
    "correspondence": {"poisson": 0.1, "stabilisation": 0.5},
}
RECORD = ["u", "v", "strain", "stress", "pressure", "energy_flux"]
POINTS = [(0.0, 0.0), (1.0, -2.0), (0.4, 0.7)]


def solid(material="bond-based", plane=None):
    return fh.Elastic(fh.Kernel(2.0, exponent=1), young=2.0, material=material, plane=plane, **MATERIALS[material])


def plate(half=12.0):
    return fh.Lattice(1.0, (-half, -half), (half, half))


@pytest.mark.parametrize("plane", ["strain", "stress"])
@pytest.mark.parametrize("material", MATERIALS)
def test_what_is_held_is_stressed_and_what_is_free_is_not(material, plane):
    """Warmed evenly: the classical ``- E alpha T / (1 - nu)`` in plane stress, ``- E alpha T / (1 - 2 nu)`` in plane
    strain.
    """
    model, load = solid(material, plane), fh.ThermalLoad(35.0, expansion=1e-3, reference=20.0)
    ratio, thermal_strain = model.poisson, 15e-3
    held, free = fh.Receivers(POINTS, RECORD), fh.Receivers(POINTS, RECORD, interpolation="linear")
    fh.Simulation(plate(), model, fh.Periodic(), loads=[load], observe=[held]).step(3)
    expected = -thermal_strain * model.young / (1 - (1 if plane == "stress" else 2) * ratio)
    np.testing.assert_allclose(held.data["stress"], np.broadcast_to(expected * np.eye(2), (4, 3, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(held.data["pressure"], -expected)
    grown = thermal_strain * (1 if plane == "stress" else 1 + ratio)
    start = {"u": [lambda x, y: grown * x, lambda x, y: grown * y]}
    fh.Simulation(plate(), model, fh.Free(), start, loads=[load], observe=[free]).step(3)
    assert np.abs(free.data["stress"]).max() < 1e-12 * abs(expected)
    np.testing.assert_allclose(free.data["strain"], np.broadcast_to(grown * np.eye(2), (4, 3, 2, 2)), atol=1e-12)


@pytest.mark.parametrize("material", MATERIALS)
def test_a_frame_of_held_nodes_may_be_warm(material):
    """A held side may not; inside a frame of held nodes as wide as bonds reach, nothing moves and all is stressed."""
    model, load = solid(material, "stress"), fh.ThermalLoad(35.0, expansion=1e-3, reference=20.0)
    with pytest.raises(fh.InputError, match="Prescribed nodes beside a Free side"):
        fh.Simulation(plate(), model, fh.Fixed(), loads=[load])
    receivers = fh.Receivers(POINTS, RECORD)
    frame = fh.Prescribed(np.max(np.abs(plate().coordinates()), axis=0) > 8, [0.0, 0.0])
    sim = fh.Simulation(plate(), model, fh.Free(), loads=[load], constraints=[frame], observe=[receivers])
    sim.step(40)
    assert np.abs(sim.fields["u"]).max() < 1e-14
    expected = -15e-3 * model.young / (1 - model.poisson) * np.eye(2)
    np.testing.assert_allclose(receivers.data["stress"], np.broadcast_to(expected, (41, 3, 2, 2)), atol=1e-12)


def given(every=None):
    """A temperature that rises in a spot, which the solid may read only at intervals."""
    load = fh.ThermalLoad("20 + 40*exp(-(x**2 + y**2)/1.5)*(1 - exp(-t/3))", 1e-3, 20.0, every=every)
    return {"model": solid("state-based"), "loads": [load], "boundary": fh.LatticePML(nodes=8)}


def computed(coupled):
    """A temperature that is computed with the displacements, or beside them."""
    heat = fh.Heat(fh.Kernel(2.0), density=1.0, specific_heat=0.5, conductivity=0.1)
    model = fh.Thermoelastic(solid(), heat, expansion=1e-3, reference=300.0, coupled=coupled)
    return {"model": model, "boundary": fh.Free(), "initial": {"T": "300 + 40*exp(-(x**2 + y**2)/6)"}}


SETUPS = {"given": given(), "given at looks": given(4.0), "coupled": computed(True), "beside": computed(False)}


@pytest.mark.parametrize("name", SETUPS)
def test_stresses_are_those_of_the_strains_that_heat_has_not_made(name):
    """In every step of a run, on nodes, where the fields contain the thermal strain. The energy flux is that of the
    mean stress of two steps, and Fourier sums are those of the rows.
    """
    receivers, spectra = fh.Receivers(POINTS, RECORD), fh.Spectra(POINTS, [0.02, 0.05], ["stress"])
    sim = fh.Simulation(plate(), **SETUPS[name], observe=[receivers, spectra])
    sim.run(until=30 * sim.dt)
    slow, thermal = fh.Simulation(plate(), **SETUPS[name]), []
    for _ in range(31):
        strains = slow.fields["thermal_strain"]
        thermal.append([strains[slow.lattice.index(point)] for point in POINTS[:2]])
        slow.step()
    recorded, (lame, shear) = receivers.data, sim.model.moduli
    strain, thermal = recorded["strain"][:, :2], np.array(thermal)
    assert np.abs(thermal).max() > 5e-3
    elastic = strain - thermal[..., None, None] * np.eye(2)
    expected = lame * np.trace(elastic, axis1=-2, axis2=-1)[..., None, None] * np.eye(2) + 2 * shear * elastic
    size = np.abs(expected).max()
    np.testing.assert_allclose(recorded["stress"][:, :2], expected, rtol=0, atol=1e-12 * size)
    middle = (recorded["stress"][1:] + recorded["stress"][:-1]) / 2
    flux = -np.einsum("tnij,tni->tnj", middle, recorded["v"][1:])
    np.testing.assert_allclose(recorded["energy_flux"][1:], flux, rtol=0, atol=1e-12 * np.abs(flux).max())
    phases = np.exp(-2j * np.pi * np.outer(spectra.frequencies, receivers.times))
    sums = sim.dt * np.einsum("ft,tnij->fnij", phases, recorded["stress"])
    np.testing.assert_allclose(spectra.data["stress"], sums, rtol=0, atol=1e-12 * np.abs(sums).max())


@pytest.mark.parametrize("name", ["given at looks", "coupled"])
def test_a_run_that_goes_on_records_the_same(name, tmp_path):
    kept, again = (fh.Receivers(POINTS, RECORD) for _ in range(2))
    sim = fh.Simulation(plate(), **SETUPS[name], observe=[kept])
    sim.step(7)
    sim.save(tmp_path / "half")
    sim.step(9)
    fh.Simulation.restore(tmp_path / "half", observe=[again]).step(9)
    for quantity, values in kept.data.items():
        np.testing.assert_array_equal(again.data[quantity], values)
