"""Thermal strain of solids: free bodies stay free of stress, and held ones have the classical stress."""

import numpy as np
import pytest
from scipy.special import erf

import farhorizon as fh
from farhorizon.simulation.recorders.quantities import nodal_stress

BONDS = fh.Kernel(2.0, exponent=1)
MATERIALS = {
    "bond-based": {},
    "state-based": {"poisson": 0.3},
    "correspondence": {"poisson": 0.1, "stabilisation": 0.5},
}
BASE, SLOPE = 1e-3, 2e-4  # the thermal strain is BASE + SLOPE x


def warmed(dim, material, plane=None, half=5):
    """A body with free sides, displaced as its thermal strain ``(BASE + SLOPE x) 1`` displaces it: the strain is
    compatible, and in plane strain the displacements are larger by the factor 1 + Poisson's ratio.
    """
    lattice = fh.Lattice(1.0, [-half] * dim, [half] * dim)
    solid = fh.Elastic(BONDS, young=1.0, material=material, plane=plane, **MATERIALS[material])
    held = 1 + solid.poisson if dim == 2 and plane != "stress" else 1.0
    x, *across = np.meshgrid(*lattice.axes, indexing="ij")
    u = [BASE * x + SLOPE / 2 * (x**2 - sum(y**2 for y in across)), *((BASE + SLOPE * x) * y for y in across)]
    load = fh.ThermalLoad("20 + x", expansion=SLOPE, reference=20 - BASE / SLOPE)
    return fh.Simulation(lattice, solid, fh.Free(), {"u": held * np.array(u)}, loads=[load])


def forces(sim, warm=True):
    """Accelerations of the nodes of the body, with or without the thermal load."""
    engine = sim.engine
    rates = engine.apply(engine.current) if warm else engine.apply_core(engine.current.copy())
    rates = sim.parts.grid.view(rates).reshape(sim.field_shape)
    return rates if sim.lattice.mask is None else rates * sim.lattice.mask


@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_a_bond_based_plate_grows_without_stress(plane):
    """A linear temperature strains each bond by the mean of its ends, as the displacements do: no node accelerates."""
    sim = warmed(2, "bond-based", plane)
    assert np.abs(forces(sim)).max() < 1e-12 * np.abs(forces(sim, warm=False)).max()
    sim.step(20)
    assert np.abs(sim.fields["v"]).max() < 1e-12 * np.abs(sim.fields["u"]).max() / sim.dt
    assert abs(sim.energies()["strain"]) < 1e-20
    stress = nodal_stress(sim)
    assert max(np.abs(stress[f"stress_{part}"]).max() for part in ("xx", "xy", "yy")) < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("dim", [2, 3])
def test_free_bodies_grow_without_stress(material, dim):
    """In the interior, to rounding. At the surface, state-based and correspondence materials see half a family, in
    which a linear temperature does cause forces.
    """
    sim = warmed(dim, material)
    inside = (slice(None), *[slice(4, -4)] * dim)
    assert np.abs(forces(sim)[inside]).max() < 1e-12 * np.abs(forces(sim, warm=False)).max()


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
def test_an_even_temperature_leaves_cut_bodies_free_of_stress(material):
    """Also where bonds are cut, by a hole and a crack; the strain energy vanishes, too."""
    body = fh.Box((-9.0, -9.0), (9.0, 9.0)) - fh.Disc(2.2, (3.0, 3.0))
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0), body=body)
    solid = fh.Elastic(BONDS, young=1.0, material=material, plane="stress", **MATERIALS[material])
    load = fh.ThermalLoad(100.0, expansion=1e-5, reference=0.0)
    x, y = np.meshgrid(*lattice.axes, indexing="ij")
    sim = fh.Simulation(
        lattice, solid, fh.Free(), {"u": 1e-3 * np.array([x, y])}, cracks=[[(-6.0, -3.5), (0.0, -3.5)]], loads=[load]
    )
    held = fh.Simulation(lattice, solid, fh.Free(), loads=[load])
    assert np.abs(forces(sim)).max() < 1e-12 * np.abs(forces(sim, warm=False)).max()
    assert abs(sim.energies()["strain"]) < 1e-10 * held.energies()["strain"]
    assert held.energies()["strain"] > 0


@pytest.mark.parametrize("material", MATERIALS)
def test_a_held_solid_is_under_the_classical_stress(material):
    """A node of an infinite plate that is held has the energy ``E / (1 - nu) (alpha T)^2``, in every material."""
    lattice = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))
    solid = fh.Elastic(BONDS, young=2.0, material=material, plane="stress", **MATERIALS[material])
    load = fh.ThermalLoad(100.0, expansion=1e-5, reference=0.0)
    sim = fh.Simulation(lattice, solid, fh.Periodic(), loads=[load])
    expected = 2.0 / (1 - solid.poisson) * 1e-6 * 13**2
    assert sim.energies()["strain"] == pytest.approx(expected, rel=1e-12)
    sim.step(3)
    assert np.abs(sim.fields["u"]).max() < 1e-15


def pulse(spacing, material="bond-based"):
    """A strip that is periodic along y and suddenly heated, and the waves that it sends out: with the thermal strain
    w = ``exp(-x^2)`` from t = 0 on, ``u_x`` follows from ``w - (w(x - ct) + w(x + ct)) / 2``.
    """
    lattice = fh.Lattice(spacing, (-10.0, -4 * spacing), (10.0, 4 * spacing))
    more = MATERIALS[material]
    solid = fh.Elastic(fh.Kernel(2 * spacing, exponent=1), young=1.0, material=material, **more)
    sides = {"x": fh.LatticePML(nodes=16), "y": fh.Periodic()}
    load = fh.ThermalLoad("exp(-x**2)", expansion=1e-3, reference=0.0)
    sim = fh.Simulation(lattice, solid, sides, loads=[load], dt=0.2 * spacing)
    sim.run(3.0, progress=False)
    return sim


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
def test_waves_of_sudden_heat_are_the_classical_ones(material):
    """At second order: ``u_xx c^2 - u_tt = B w_x``, with B the force of an isotropic strain over the density."""
    errors, spacings = [], (0.25, 0.125, 0.0625)
    for spacing in spacings:
        sim = pulse(spacing, material)
        solid, c, t = sim.model, sim.model.p_speed, sim.time
        x = sim.lattice.axes[0]
        factor = 1e-3 * (1 + solid.poisson) * 2 * (solid.lame + solid.shear) / solid.p_modulus
        exact = factor * np.sqrt(np.pi) / 2 * (erf(x) - (erf(x - c * t) + erf(x + c * t)) / 2)
        errors.append(np.abs(sim.fields["u"][0, :, 4] - exact).max() / np.abs(exact).max())
    order = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    assert order > 1.8
    assert errors[-1] < 0.01


@pytest.mark.slow
def test_layers_take_the_waves_of_heat():
    """Against a larger domain, after the waves have crossed the smaller one twice."""
    near, far = (
        fh.Simulation(
            fh.Lattice(1.0, (-n, -n), (n, n)),
            fh.Elastic(BONDS, young=1.0),
            fh.LatticePML(nodes=16),
            loads=[fh.ThermalLoad("exp(-(x**2 + y**2)/8)*sin(t/8)**2*(t < 8*pi)", expansion=1e-3, reference=0.0)],
            dt=0.4,
        )
        for n in (16.0, 80.0)
    )
    for sim in (near, far):
        sim.run(80.0, progress=False)
    part = slice(64, -64)
    difference = np.abs(near.fields["u"] - far.fields["u"][:, part, part]).max()
    assert difference < 1e-4 * 1e-3  # the target of the layer times the largest strain, over one spacing


@pytest.mark.slow
def test_a_run_of_heat_beside_it_is_its_field():
    """The thermal strain is that of the temperature of a run of its own; a run that is resumed agrees bit for bit."""
    lattice = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0))
    heat = fh.Setup(lattice, fh.Diffusion(fh.Kernel(2.0), 0.05), initial={"u": "exp(-(x**2 + y**2)/9)"})
    load = fh.ThermalLoad(heat, expansion=1e-3, reference=0.0)
    solid = fh.Elastic(BONDS, young=1.0, plane="stress", critical_stretch=1.0)

    def run():
        return fh.Simulation(lattice, solid, fh.LatticePML(nodes=12), loads=[load])

    sim, again = run(), run()
    sim.step(50)
    beside = fh.Simulation.of(heat).run(sim.time, progress=False)
    # the temperature is interpolated linearly between its steps, each of which changes it by a percent
    change = np.abs(beside.fields["u"] - np.exp(-sum(x**2 for x in lattice.coordinates()) / 9)).max()
    assert np.abs(1e3 * sim.fields["thermal_strain"] - beside.fields["u"]).max() < 0.05 * change
    again.step(23)
    arrays, meta = again.time_loop.state(again.step_count)
    third = run()
    kept = {name: values.copy() for name, values in arrays.items()}
    assert third.time_loop.take([(meta["boxes"][0], kept)], dict(meta))
    third.time_loop.complete()
    third.step_count = again.step_count
    third.step(27)
    np.testing.assert_array_equal(third.fields["u"], sim.fields["u"])


@pytest.mark.slow
def test_a_checkpoint_has_the_run_beside_it(tmp_path):
    """Bit for bit, with bonds that have broken and a density that varies; the run of the temperature is made anew."""
    lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    heat = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(2.0), 0.05), initial={"u": "exp(-(x**2 + y**2)/6)"})
    solid = fh.Elastic(BONDS, young=1.0, critical_stretch=2e-4, density="1 + (x > 3)")
    load = fh.ThermalLoad(heat, expansion=1.4e-3, reference=0.0)
    sim = fh.Simulation(lattice, solid, fh.Free(), loads=[load], dt=0.3)
    sim.step(17)
    sim.save(tmp_path / "state.h5")
    again = fh.Simulation.restore(tmp_path / "state.h5")
    for run in (sim, again):
        run.step(20)
    assert sim.broken_bonds > 0
    for name, values in sim.fields.items():
        np.testing.assert_array_equal(again.fields[name], values)


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
def test_energies_of_a_steady_temperature_add_up(material):
    """The sum of kinetic energy, strain energy and what breaking dissipates is constant, to rounding of the energy
    stored by the thermal strain.
    """
    solid = fh.Elastic(
        BONDS, young=1.0, material=material, plane="stress", critical_stretch=2e-4, **MATERIALS[material]
    )
    load = fh.ThermalLoad("exp(-(x**2 + y**2)/8)", expansion=1.4e-3, reference=0.0)
    sim = fh.Simulation(
        fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0)), solid, fh.Free(), loads=[load], balance=True, dt=0.3
    )
    first = sim.energies()
    sim.step(100)
    last = sim.energies()
    assert sim.broken_bonds > 0
    assert sum(last.values()) == pytest.approx(sum(first.values()), rel=1e-10)


BAD = {
    "load.reference": lambda: fh.ThermalLoad("20 + x", expansion=1e-5),
    "load.expansion": lambda: fh.ThermalLoad("20 + x", reference=20.0),
    "load[0].temperature": lambda: set_up(fh.ThermalLoad(fh.Setup(SMALL, fh.Wave(fh.Kernel(2.0))), 1e-5, 0.0)),
    "load.temperature": lambda: set_up(fh.ThermalLoad(20.0, 1e-5, 0.0)),
    "load[1]": lambda: set_up(*[fh.ThermalLoad("exp(-x**2)", 1e-5, 0.0)] * 2),
    "load": lambda: set_up(fh.ThermalLoad("exp(-x**2)", 1e-5, 0.0), nonlinear=True),
}
SMALL = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))


def set_up(*loads, **more):
    return fh.Simulation(SMALL, fh.Elastic(BONDS, young=1.0, **more), fh.LatticePML(nodes=8), loads=loads)


@pytest.mark.parametrize("key", BAD)
def test_bad_input(key):
    """Missing constants, a field of waves, heat at a layer, two temperatures, and nonlinear bonds."""
    with pytest.raises(fh.InputError) as caught:
        BAD[key]()
    assert caught.value.key == key
    assert caught.value.remedy or caught.value.limit


def test_a_run_on_other_nodes_is_refused():
    other = fh.Setup(fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0)), fh.Diffusion(fh.Kernel(2.0)))
    with pytest.raises(fh.InputError, match="nodes that are not those of the solid"):
        set_up(fh.ThermalLoad(other, 1e-5, 0.0))


def test_images_beyond_a_wall_have_no_temperature():
    heat = fh.Setup(
        SMALL, fh.Diffusion(fh.Kernel(2.0)), fh.Free(), constraints=[fh.Temperature("x-", 1.0, kind="mirror")]
    )
    with pytest.raises(fh.InputError, match=r'not known on nodes.*34 nodes; remedy: .* another kind than "mirror"'):
        set_up(fh.ThermalLoad(heat, 1e-5, 0.0))
