"""Sides on springs and dashpots: reflection against closed forms, on the lattice and of long waves, energies, supports
beside absorbing sides, certificates, cases, bad input.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

SPACING, SPEED = 0.1, 1.5


def reflected(side, kernel, spacing, frequencies, width=1.0, density=1.0):
    """Reflection of the displacement at x = 0 for ``exp(-i w t)``, and the phase factors of a step, from the records
    of a pulse at a node that it passes twice; with the wave numbers.
    """
    far, near = 100.0, 20.0
    bar = fh.Lattice(spacing, -far, 0.0)
    model = fh.Wave(kernel, speed=SPEED, density=density)
    start = {"u": f"exp(-((x + {2 * near})/{width})**2)"}
    seen = fh.Receivers([(-near,)], name="seen")
    sides = {"x-": fh.Free(), "x+": side}
    sim = fh.Simulation(bar, model, sides, start, observe=[seen], dt=0.4 * spacing / SPEED)
    sim.run(90.0 / SPEED, progress=False)
    t, u = seen.times, seen.data["u"][:, 0]
    half = 2 * near / SPEED
    spectra = [
        np.array([(u[part] * np.exp(1j * w * t[part])).sum() for w in frequencies]) for part in (t <= half, t > half)
    ]
    return sim, spectra[1] / spectra[0], near


def on_the_lattice(w, dt, spacing, stiffness, viscosity):
    """Exact reflection at the last node of a chain of nearest neighbours, and its wave number."""
    unit, s = (SPEED / spacing) ** 2, 4 * np.sin(w * dt / 2) ** 2 / dt**2
    k = 2 / spacing * np.arcsin(np.sqrt(s / unit) / 2)
    held = -s + stiffness / spacing - 1j * viscosity / spacing * np.sin(w * dt) / dt
    back, ahead = unit * (np.exp(-1j * k * spacing) - 1), unit * (np.exp(1j * k * spacing) - 1)
    return (back - held) / (held - ahead), k


@pytest.mark.parametrize(("stiffness", "viscosity"), [(0.0, 0.6), (0.0, SPEED), (2.5, 0.0), (6.0, 4.0), (30.0, 0.2)])
def test_a_chain_reflects_as_its_last_node_tells(stiffness, viscosity):
    """To the error of the record, which begins and ends with less than 1e-8 of the pulse."""
    w = SPEED * np.array([0.5, 1.0, 2.0, 3.0])
    side = fh.Impedance(stiffness, viscosity)
    sim, found, near = reflected(side, fh.Kernel(SPACING), SPACING, w)
    exact, k = on_the_lattice(w, sim.dt, SPACING, stiffness, viscosity)
    np.testing.assert_allclose(found, exact * np.exp(2j * k * near), rtol=0, atol=1e-6)


@pytest.mark.parametrize("reach", [1, 3])
@pytest.mark.parametrize(("stiffness", "viscosity"), [(0.0, 0.5 * SPEED), (0.0, SPEED), (0.0, 4 * SPEED), (1.2, 0.0)])
def test_long_waves_are_reflected_as_in_the_continuum(reach, stiffness, viscosity):
    """R = (Z0 - Z) / (Z0 + Z) with ``Z = eta + i k / w``: a dashpot changes the amplitude, a spring the phase alone; of
    first order in the spacing, because the nodes end half a spacing before the face.
    """
    w = SPEED * np.array([0.5, 1.0])
    z = viscosity + 1j * stiffness / w
    exact, errors = (SPEED - z) / (SPEED + z), []
    for spacing in (0.1, 0.05):
        side = fh.Impedance(stiffness, viscosity)
        found = reflected(side, fh.Kernel(reach * spacing), spacing, w)[1]
        free = reflected(fh.Free(), fh.Kernel(reach * spacing), spacing, w)[1]  # of phase alone
        errors.append(np.abs(found / free - exact).max())
        if not viscosity:
            assert np.abs(np.abs(found) - 1).max() < 1e-6
            phase = np.angle(found / free)
            assert np.abs(phase + 2 * np.arctan(stiffness / w / SPEED)).max() < 2 * spacing
    assert errors[0] < 0.07 and errors[1] < 0.7 * errors[0]


def strip(**given):
    """A strip of a solid along x that is periodic along y."""
    return fh.Lattice(0.25, (-16.0, 0.0), (0.0, 2.0)), {"x-": fh.Free(), "y": fh.Periodic()} | given


@pytest.mark.parametrize("material", ["bond-based", "state-based", "correspondence"])
def test_matched_dashpots_absorb_both_waves_of_a_solid(material):
    """Lysmer and Kuhlemeyer's viscous boundary, at normal incidence; without tangential dashpots of its own the shear
    wave meets the impedance of the other.
    """
    options = {} if material == "bond-based" else {"poisson": 0.2}
    options |= {"stabilisation": 0.1} if material == "correspondence" else {}
    model = fh.Elastic(fh.Kernel(0.5, exponent=1), 2.0, density=3.0, material=material, **options)
    zp, zs = model.density * model.p_speed, model.density * model.s_speed
    left = []
    for side, component in (
        (fh.Impedance(viscosity=zp, tangential_viscosity=zs), 0),
        (fh.Impedance(viscosity=zp, tangential_viscosity=zs), 1),
        (fh.Impedance(viscosity=zp), 1),
    ):
        speed = (model.p_speed, model.s_speed)[component]
        start = {"u": [0.0, 0.0], "v": [0.0, 0.0]}
        start["u"][component] = "1e-3*exp(-((x + 8)/1.5)**2)"
        start["v"][component] = f"{speed}*2*(x + 8)/1.5**2*1e-3*exp(-((x + 8)/1.5)**2)"
        lattice, sides = strip(**{"x+": side})
        sim = fh.Simulation(lattice, model, sides, start).run(16.0 / speed, progress=False)
        left.append(np.abs(sim.fields["u"]).max() / 1e-3)
    error = 0.08 if material == "correspondence" else 0.04  # half of that at half the spacing
    assert max(left[:2]) < error
    assert left[2] == pytest.approx((zp - zs) / (zp + zs), abs=error)


@pytest.mark.parametrize("density", [1.0, "2 + x/20"])
def test_springs_keep_the_energy_and_dashpots_take_it(density):
    lattice, sides = strip()
    start = {"v": ["1e-3*exp(-(x + 4)**2)", "1e-3*exp(-(x + 5)**2)"]}
    model = fh.Elastic(fh.Kernel(0.5, exponent=1), 2.0, density=density)
    lost, supported = [], 0.0
    for side in (fh.Impedance(0.3, tangential_stiffness=0.7), fh.Impedance(0.3, 0.8)):
        sim = fh.Simulation(lattice, model, sides | {"x+": side}, start, balance=True)
        for t in (6.0, 12.0, 18.0):
            balance = sim.run(t, progress=False).balance()
            supported = max(supported, balance["support"] / sim.time_loop.first_energy)
            lost.append(balance["lost"] / sim.time_loop.first_energy)
    assert np.abs(lost[:3]).max() < 1e-12
    assert supported > 0.02
    assert lost[3] > 0.01 and (np.diff(lost[3:]) > 0).all() and lost[-1] < 1


def test_what_dashpots_take_is_their_power():
    """``eta v^2``, with v the mean velocity over two steps, as the scheme sees it."""
    bar, eta = fh.Lattice(SPACING, -12.0, 0.0), 0.7
    sides = {"x-": fh.Free(), "x+": fh.Impedance(viscosity=eta)}
    model = fh.Wave(fh.Kernel(SPACING), speed=SPEED)
    sim = fh.Simulation(bar, model, sides, {"u": "exp(-(x + 5)**2)"})
    end, energies = [], []
    for _ in range(200):
        sim.step()
        end.append(sim.fields["u"][-1])
        energies.append(sum(sim.energies()[name] for name in ("kinetic", "strain")))
    velocity = (np.array(end[2:]) - end[:-2]) / (2 * sim.dt)
    taken = eta * sim.dt * np.cumsum(velocity**2)
    np.testing.assert_allclose(energies[1] - np.array(energies[2:]), taken, rtol=0, atol=1e-12)


def test_a_support_continues_beside_an_absorbing_side():
    """A plate on springs and dashpots, cut off by layers, and the same much wider: equal to the target."""
    model = fh.Elastic(fh.Kernel(1.0, exponent=1), 1.0)
    start = {"u": ["0", "1e-3*exp(-(x**2 + (y + 2)**2)/2)"]}
    side = fh.Impedance(0.2, 0.3)
    runs = []
    for half in (5.0, 25.0):
        lattice = fh.Lattice(0.5, (-half, -5.0), (half, 0.0))
        sides = {"x": fh.LatticePML(nodes=24) if half < 10 else fh.Free(), "y-": side, "y+": fh.Free()}
        runs.append(fh.Simulation(lattice, model, sides, start, dt=0.2).run(20.0, progress=False).fields["u"])
    narrow, wide = runs[0], runs[1][:, 40:-40]
    assert narrow.shape == wide.shape
    assert np.abs(narrow - wide).max() < 1e-3 * 1e-3


def test_stability_is_proved_and_the_step_considers_springs():
    lattice, sides = strip(**{"x+": fh.Impedance(50.0, 2.0)})
    model = fh.Elastic(fh.Kernel(0.5, exponent=1), 2.0)
    sim = fh.Simulation(lattice, model, sides, {"u": ["1e-3*exp(-x**2)", 0.0]})
    assert "cannot grow" in str(sim.certificate())
    free = fh.Simulation(lattice, model, sides | {"x+": fh.Free()})
    assert (2 / sim.step_limit) ** 2 == pytest.approx((2 / free.step_limit) ** 2 + 50.0 / 0.25)
    with pytest.raises(fh.InputError, match=r"run\.dt: the time step is above"):
        fh.Simulation(lattice, model, sides, dt=0.99 * free.step_limit)
    assert np.abs(sim.run(50.0, progress=False).fields["u"]).max() < 1e-3


def test_corners_have_both_supports_and_bodies_only_where_they_are():
    lattice = fh.Lattice(
        0.5, (-4.0, -4.0), (4.0, 4.0), body=fh.Box((-5.0, -5.0), (5.0, 5.0)) - fh.Disc(1.0, (4.0, 0.0))
    )
    model = fh.Elastic(fh.Kernel(1.0, exponent=1), 1.0, density=2.0)
    sides = {"x-": fh.Free(), "x+": fh.Impedance(1.0, 3.0, 2.0), "y-": fh.Impedance(4.0), "y+": fh.Free()}
    supports = fh.Simulation(lattice, model, sides).parts.near.supports
    unit = 2.0 * 0.5  # mass of a node over its area
    assert supports.stiffness[:, -1, 0] * unit == pytest.approx([1.0 + 4.0, 2.0 + 4.0])
    assert supports.damping[:, -1, 3] * 2 * unit == pytest.approx([3.0, 3.0])
    assert supports.stiffness[0, -1, 8] == 0
    assert not supports.stiffness[:, 3, 5].any()


def test_checkpoints_continue(tmp_path):
    lattice, sides = strip(**{"x+": fh.Impedance(0.3, 0.8, tangential_viscosity=0.2)})
    sim = fh.Simulation(lattice, fh.Elastic(fh.Kernel(0.5, exponent=1), 2.0), sides, {"v": ["exp(-x**2)", "0"]})
    sim.step(20)
    sim.save(tmp_path / "a.ckpt")
    again = fh.Simulation.restore(tmp_path / "a.ckpt")
    for run in (sim, again):
        run.step(20)
    np.testing.assert_array_equal(sim.fields["u"], again.fields["u"])


@pytest.mark.parametrize("constant", ["speed", "density"])
def test_gradients_are_those_of_differences(constant):
    """Springs and dashpots are reciprocal, also where the medium of their own nodes changes."""
    lattice = fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0))
    receivers = fh.Receivers([(3.0, -5.0), (-3.0, -4.0)])
    sides = {"x": fh.Free(), "y-": fh.Impedance(0.5, 0.8), "y+": fh.Free()}
    sources = [fh.PointSource((0.3, 0.2), time=fh.Ricker(0.15))]

    def setup(place=None, change=0.0):
        constants = {"speed": np.ones(lattice.shape), "density": np.ones(lattice.shape)}
        if place is not None:
            constants[constant][place] += change
        return fh.Setup(lattice, fh.Wave(fh.Kernel(1.0), **constants), sides, {}, sources=sources, dt=0.1)

    def misfit(place, change):
        seen = fh.Receivers(receivers.points)
        fh.Simulation.of(setup(place, change), [seen]).run(12.0, progress=False)
        return (seen.data["u"] ** 2).sum() / 2

    found = fh.gradient(setup(), fh.LeastSquares(receivers, np.zeros((121, 2))), wrt=constant, until=12.0)
    for place in ((12, 0), (8, 1), (12, 6)):
        difference = (misfit(place, 1e-4) - misfit(place, -1e-4)) / 2e-4
        assert found[constant][place] == pytest.approx(difference, rel=1e-5)


# --- cases and bad input ------------------------------------------------------------------------------------------

CASE = """
units = { length = "m", time = "s", mass = "kg" }
lattice = { spacing = 0.5, lower = [-4.0, -4.0], upper = [4.0, 4.0] }
model = { type = "elastic", young = "2 MPa", density = 2000.0, kernel = { horizon = 1.0, exponent = 1 } }
initial = { v = ["1e-3*exp(-x**2 - y**2)", 0.0] }
run = { until = 1.0 }
[boundary]
all = { type = "free" }
"y-" = { type = "impedance", stiffness = "1 kPa/mm", viscosity = 3e4, tangential_viscosity = 2e4 }
"""


def test_case_of_an_impedance():
    sim = Case(CASE).simulation()
    assert sim.sides[1, -1] == fh.Impedance(1e6, 3e4, None, 2e4)
    assert "certified" in str(sim.check())


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("= 3e4", "= -3e4", r"boundary\.y-\.viscosity"),
        ('stiffness = "1 kPa/mm", viscosity = 3e4, tangential_viscosity = 2e4', "stiffness = 0.0", "neither springs"),
        ('"1 kPa/mm"', '"1 kg"', r"boundary\.y-\.stiffness"),
    ],
)
def test_bad_cases_of_impedances(old, new, words):
    assert CASE.count(old) == 1
    with pytest.raises(fh.InputError, match=words):
        Case(CASE.replace(old, new)).simulation()


def test_where_impedances_are_not_available():
    with pytest.raises(fh.InputError, match=r"boundary\.viscosity"):
        fh.Impedance(1.0, None)
    bar = fh.Lattice(0.5, 0.0, 9.0)
    with pytest.raises(fh.InputError, match=r"boundary\.x-: .* a side of waves and solids; .*remedy: .*Convection"):
        fh.Simulation(bar, fh.Diffusion(fh.Kernel(0.5)), fh.Impedance(1.0))
    with pytest.raises(fh.InputError, match=r"boundary\.x-\.tangential_stiffness: a field of one component"):
        fh.Simulation(bar, fh.Wave(fh.Kernel(0.5)), fh.Impedance(1.0, tangential_stiffness=1.0))
    solid = fh.Elastic(fh.Kernel(0.5, exponent=1), 2.0, 0.2, material="correspondence")
    with pytest.raises(fh.InputError, match=r"boundary\.x\+: .*remedy: stabilisation=0\.1"):
        fh.Simulation(strip()[0], solid, strip(**{"x+": fh.Impedance(1.0)})[1])
    with pytest.raises(fh.InputError, match=r"Impedance does not support the modified equation"):
        fh.Simulation(bar, fh.Wave(fh.Kernel(0.5), integrator="modified-equation"), fh.Impedance(1.0))
