"""Coupled displacements and temperature, against dense numpy programs and the coupled plane wave."""

import numpy as np
import pytest

import farhorizon as fh

BONDS, FAMILY = fh.Kernel(2.0, exponent=1), fh.Kernel(2.0)
ZERO = 300.0  # reference temperature
STILL = 1e-30  # a conductivity without effect


def both(coupling=0.2, conductivity=0.3, integrator="euler", capacity=2.0, kernel=BONDS, coupled=True, **more):
    """Model with the coupling constant ``T0 beta^2 / rho c M`` of the plane or of space."""
    solid = fh.Elastic(kernel, young=1.5, density=1.2, **more)
    dim = 3 if more.get("plane") is None else 2
    expansion = np.sqrt(coupling * capacity * solid.p_modulus / ZERO) / (dim * solid.lame + 2 * solid.shear)
    # the specific heat is per mass, by the density of the heat model
    heat = fh.Heat(fh.Kernel(kernel.horizon), 4.0, capacity / 4, conductivity, integrator)
    return fh.Thermoelastic(solid, heat, expansion, ZERO, coupled)


def noise(lattice, seed=0):
    """Random initial displacements, velocities and temperatures."""
    random = np.random.default_rng(seed)
    shape = (lattice.dim, *lattice.shape)
    return {
        "u": 0.1 * random.standard_normal(shape),
        "v": 0.1 * random.standard_normal(shape),
        "T": ZERO + random.standard_normal(lattice.shape),
    }


def total(sim):
    energies = sim.energies()
    return energies["kinetic"] + energies["strain"] + energies["thermal"]


def square(n=11, **more):
    return fh.Lattice(1.0, (0.0, 0.0), (n - 1.0, n - 1.0), **more)


BODY = fh.Box((-1.0, -1.0), (20.0, 20.0)) - fh.Disc(2.2, (7.0, 7.0))
SOLIDS = {
    "periodic": (square(), {}, fh.Periodic(), {}),
    "free": (square(), {"plane": "stress"}, fh.Free(), {}),
    "held": (square(23), {}, {"x": fh.Fixed(), "y": fh.Free()}, {}),
    "hole and crack": (square(15, body=BODY), {}, fh.Free(), {"cracks": [[(-1.0, 3.5), (8.0, 3.5)]]}),
    "in space": (fh.Lattice(1.0, (0.0,) * 3, (5.0,) * 3), {}, fh.Free(), {}),
    "state-based": (square(), {"material": "state-based", "poisson": 0.3}, fh.Periodic(), {}),
    "correspondence, hole and crack": (
        square(15, body=BODY),
        {"material": "correspondence", "poisson": 0.1, "stabilisation": 0.5},
        fh.Free(),
        {"cracks": [[(-1.0, 3.5), (8.0, 3.5)]]},
    ),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", SOLIDS)
def test_nothing_is_lost_without_conduction(name):
    """The sum of kinetic, strain and thermal energy is constant to rounding, for noise, which moves ten orders more
    between them; for bonds and states.
    """
    lattice, more, sides, given = SOLIDS[name]
    start = noise(lattice)
    if name == "held":  # bonds feel no heat there
        start["T"][:4], start["T"][-4:] = ZERO, ZERO
    sim = fh.Simulation(lattice, both(conductivity=STILL, **more), sides, start, **given)
    first, thermal, energies = total(sim), sim.energies()["thermal"], []
    for _ in range(150):
        sim.step()
        energies.append((total(sim), sim.energies()["thermal"]))
    sums, heats = np.array(energies).T
    assert np.abs(sums - first).max() < 1e-13 * first
    assert np.abs(heats - thermal).max() > 1e-3 * first


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, {"material": "state-based", "poisson": 0.3}], ids=["bonds", "states"])
def test_nothing_is_lost_where_the_material_varies(more):
    """Stiffness, density and expansion vary from node to node: each bond acts alike on both of its ends."""
    x, y = square().coordinates()
    solid = fh.Elastic(BONDS, young=1 + 0.5 * np.sin(x), density=1 + 0.3 * np.cos(y), **more)
    heat = fh.Heat(FAMILY, conductivity=STILL)
    model = fh.Thermoelastic(solid, heat, 0.02 + 0.01 * np.cos(x + y), ZERO)
    sim = fh.Simulation(square(), model, fh.Free(), noise(square()))
    first = total(sim)
    sim.step(200)
    assert total(sim) == pytest.approx(first, rel=1e-13)


def dense(lattice, model, sides):
    """Matrices of a periodic or free square, bond by bond: accelerations, thermal forces and conduction."""
    solid, nodes, n = model.elastic, lattice.nodes, lattice.shape[0]
    place = np.arange(nodes).reshape(lattice.shape)
    of_u, pushed = np.zeros((2 * nodes, 2 * nodes)), np.zeros((2 * nodes, nodes))
    conducts = np.zeros((nodes, nodes))
    held = 1 + solid.poisson if solid.plane != "stress" else 1.0
    for stencil, matrix in ((solid.stencil(1.0, 2), of_u), (model.heat.stencil(1.0, 2), conducts)):
        scale = (solid if matrix is of_u else model.heat).coefficient
        for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
            for i, j in np.ndindex(lattice.shape):
                k, m = i + offset[0], j + offset[1]
                if isinstance(sides, fh.Free) and not (0 <= k < n and 0 <= m < n):
                    continue
                here, there = place[i, j], place[k % n, m % n]
                if matrix is conducts:
                    matrix[here, there] += scale * weight
                    matrix[here, here] -= scale * weight
                    continue
                for a, b in np.ndindex(2, 2):
                    matrix[a * nodes + here, b * nodes + there] += scale * weight[a, b]
                    matrix[a * nodes + here, b * nodes + here] -= scale * weight[a, b]
                    pull = scale * weight[a, b] * offset[b] * held * model.expansion / 2
                    pushed[a * nodes + here, [here, there]] -= pull
    return of_u, pushed, conducts


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
@pytest.mark.parametrize("sides", [fh.Periodic(), fh.Free()], ids=["periodic", "free"])
def test_the_steps_are_those_of_a_plain_program(sides, integrator):
    """For noise, with conduction; and the quadratic form that proves the steps stable never grows."""
    lattice, model = square(7), both(conductivity=1.0, integrator=integrator)
    sim = fh.Simulation(lattice, model, sides, noise(lattice))
    of_u, pushed, conducts = dense(lattice, model, sides)
    dt, solid, heat = sim.dt, model.elastic, model.heat
    scale = solid.density * ZERO / heat.heat_capacity  # of the trace, the adjoint of the thermal forces
    z, identity = dt * conducts, np.eye(lattice.nodes)
    growth = (
        identity + z
        if integrator == "euler"
        else identity + z @ (identity + z / 2 @ (identity + z / 3 @ (identity + z / 4)))
    )
    released = identity if integrator == "euler" else identity + z / 2 @ (identity + z / 3 @ (identity + z / 4))
    u, theta = sim.fields["u"].ravel(), sim.fields["T"].ravel() - ZERO
    older = u - dt * sim.fields["v"].ravel()
    inverse = np.linalg.inv(released)
    mass, loss = inverse + z / 2, -conducts
    forms = []
    for _ in range(60):
        newer = 2 * u - older + dt**2 * (of_u @ u + pushed @ theta)
        later = growth @ theta - released @ (scale * pushed.T @ (newer - u))
        v, middle, between = (newer - u) / dt, (newer + u) / 2, (later + theta) / 2
        gained = scale * pushed @ np.linalg.solve(mass, pushed.T @ v)
        form = v @ (v - dt**2 / 4 * (gained - of_u @ v)) - middle @ of_u @ middle
        form += between @ (mass + dt**2 / 4 * loss @ np.linalg.solve(mass, loss)) @ between / scale
        forms.append(form)
        older, u, theta = u, newer, later
        sim.step()
        np.testing.assert_allclose(sim.fields["u"].ravel(), u, rtol=0, atol=1e-13)
        np.testing.assert_allclose(sim.fields["T"].ravel() - ZERO, theta, rtol=0, atol=1e-11)  # for a sum with 300
    assert (np.diff(forms) < 1e-14 * forms[0]).all()
    assert forms[-1] < 0.9 * forms[0] and min(forms) > 0


def characteristic(model, sides_of, dt, k, spacing):
    """Coefficients of the polynomial of the growth factors of a step, for P waves of one wavenumber along x."""
    solid, heat = model.elastic, model.heat
    stencil = solid.stencil(spacing, sides_of)
    x = spacing * stencil.offsets[:, 0]
    scale = solid.coefficient / spacing**2
    rate = scale * stencil.weights[:, 0, 0] @ (1 - np.cos(k * x))
    along = np.einsum("kb,kb->k", stencil.weights[:, 0], spacing * stencil.offsets)
    held = 1 + solid.poisson if sides_of == 2 and solid.plane != "stress" else 1.0
    push = scale * held * model.expansion * along @ np.sin(k * x) / 2
    conduction = heat.stencil(spacing, sides_of)
    z = -dt * heat.coefficient / spacing**2 * conduction.weights @ (1 - np.cos(k * spacing * conduction.offsets[:, 0]))
    released = 1 + z / 2 * (1 + z / 3 * (1 + z / 4)) if heat.integrator.name != "forward Euler" else 1.0
    growth = 1 + z * released
    gained = solid.density * ZERO / heat.heat_capacity * push**2
    mechanical, thermal = np.poly([1, 1]), np.array([1, -growth])
    first = np.polymul(mechanical, thermal)
    return np.polyadd(first, dt**2 * np.polymul([1, 0], rate * thermal + gained * released * np.array([1, -1])))


@pytest.mark.parametrize("conductivity", [0.003, 0.1, 3.0], ids=["adiabatic", "between", "isothermal"])
@pytest.mark.parametrize("waves", [1, 3, 9])
def test_plane_waves_are_those_of_the_lattice(conductivity, waves):
    """The amplitudes of u and T satisfy the recurrence of the lattice's characteristic equation, to rounding."""
    n, plane = 24, "stress"
    lattice = fh.Lattice(1.0, (0.0, 0.0), (n - 1.0, 4.0))
    model = both(conductivity=conductivity, integrator="rk4", plane=plane)
    wave = np.exp(2j * np.pi * waves * np.arange(n) / n)
    start = {"u": [np.outer(wave.real, np.ones(5)), 0.0], "T": ZERO + 10 * np.outer(wave.imag, np.ones(5))}
    sim = fh.Simulation(lattice, model, fh.Periodic(), start)
    polynomial = characteristic(model, 2, sim.dt, 2 * np.pi * waves / n, 1.0)
    amplitudes = []
    for _ in range(60):
        fields = sim.fields
        amplitudes.append([(part[:, 2] * wave.conj()).mean() for part in (fields["u"][0], fields["T"] - ZERO)])
        sim.step()
    u, theta = np.array(amplitudes).T
    for amplitudes in (u, theta):
        left = sum(factor * amplitudes[3 - i : len(amplitudes) - i] for i, factor in enumerate(polynomial))
        assert np.abs(left).max() < 1e-12 * np.abs(amplitudes).max()
    assert np.abs(np.roots(polynomial)).max() < 1


def continuum(model, k, dim):
    """Rates of plane waves ``exp(s t)`` in the continuum: ``(s^2 + c^2 k^2)(s + D k^2) + e c^2 k^2 s = 0`` with the
    coupling constant e, as `ordered` sorts them: the decaying one between the two waves.
    """
    solid, heat = model.elastic, model.heat
    beta = model.expansion * (3 * solid.bulk if solid.plane != "stress" else 2 * (solid.lame + solid.shear))
    coupling = ZERO * beta**2 / (heat.heat_capacity * solid.p_modulus)
    waves, decays = (solid.p_speed * k) ** 2, heat.coefficient * k**2
    return ordered(np.roots([1, decays, waves * (1 + coupling), waves * decays]))


def ordered(rates):
    return rates[np.argsort(-rates.imag)]


@pytest.mark.parametrize("dim, plane", [(2, None), (2, "stress"), (3, None)])
@pytest.mark.parametrize("conductivity", [0.003, 0.5, 30.0], ids=["adiabatic", "between", "isothermal"])
def test_plane_waves_are_those_of_the_continuum(dim, plane, conductivity):
    """Speed, attenuation, and the decay of what is left behind, at second order in the spacing."""
    errors, spacings = [], np.array([0.2, 0.1, 0.05])
    for spacing in spacings:
        model = both(
            conductivity=conductivity, integrator="rk4", kernel=fh.Kernel(2 * spacing, exponent=1), plane=plane
        )
        dt = 0.05 * spacing if conductivity < 1 else 0.2 * spacing**2  # for the limit of conduction
        rates = ordered(np.log(np.roots(characteristic(model, dim, dt, 1.0, spacing)).astype(complex)) / dt)
        exact = continuum(model, 1.0, dim)
        errors.append(np.abs(rates[[0, 1]] - exact[[0, 1]]) / np.abs(exact[[0, 1]]))
    orders = [np.polyfit(np.log(spacings), np.log(error), 1)[0] for error in np.array(errors).T]
    assert min(orders) > 1.9
    assert np.max(errors[-1]) < 1e-3


MATERIALS = {
    "bond-based": {},
    "state-based": {"poisson": 0.3},
    "correspondence": {"poisson": 0.1, "stabilisation": 0.5},
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("dim, plane", [(2, None), (2, "stress"), (3, None)])
def test_what_is_stretched_cools_as_the_classical_solution_says(material, dim, plane):
    """By ``T0 beta tr e / rho c`` in the interior, in one step of a uniform dilatation: beta is
    ``E alpha / (1 - 2 nu)``, in plane stress ``E alpha / (1 - nu)``.
    """
    lattice = fh.Lattice(1.0, (-5.0,) * dim, (5.0,) * dim)
    model = both(conductivity=STILL, material=material, plane=plane, **MATERIALS[material])
    rate, capacity, solid = 1e-3, 2.0, model.elastic
    sim = fh.Simulation(lattice, model, fh.Free(), {"v": [rate * x for x in lattice.coordinates()]})
    sim.step()
    beta = model.expansion * solid.young / (1 - (2 if plane is None else 1) * solid.poisson)
    inside = (slice(4, -4),) * dim
    expected = -ZERO * beta * dim * rate * sim.dt / capacity
    np.testing.assert_allclose(sim.fields["T"][inside] - ZERO, expected, rtol=1e-9)  # for a sum with 300


@pytest.mark.parametrize("dim, plane", [(2, None), (2, "stress"), (3, None)])
def test_a_free_body_grows_without_stress(dim, plane):
    """Warmed evenly and displaced accordingly, with a hole in it: no forces arise, and nothing moves or cools."""
    reach, model = 6.0, both(plane=plane)
    body = fh.Box((-7.0,) * dim, (7.0,) * dim) - (fh.Disc if dim == 2 else fh.Ball)(2.2, (1.0,) * dim)
    lattice = fh.Lattice(1.0, (-reach,) * dim, (reach,) * dim, body=body)
    held = 1 + model.elastic.poisson if dim == 2 and plane is None else 1.0
    strain = 10 * held * model.expansion
    start = {"T": ZERO + 10, "u": [strain * x for x in lattice.coordinates()]}
    sim = fh.Simulation(lattice, model, fh.Free(), start)
    engine, size = sim.engine, strain * sim.rate_limit * reach
    assert np.abs(sim.parts.grid.view(engine.apply(engine.current))[..., lattice.mask]).max() < 1e-12 * size
    sim.step(30)
    assert np.nanmax(np.abs(sim.fields["T"] - ZERO - 10)) < 1e-12 * ZERO
    assert np.nanmax(np.abs(sim.fields["v"])) < 1e-12 * strain * reach / sim.dt


def update(lattice, model, sides, dt):
    """The map of one Euler step of u, u one step ago and the temperature, as a matrix."""
    of_u, pushed, conducts = dense(lattice, model, sides)
    scale = model.elastic.density * ZERO / model.heat.heat_capacity
    n, m = of_u.shape[0], lattice.nodes
    top = np.hstack([2 * np.eye(n) + dt**2 * of_u, -np.eye(n), dt**2 * pushed])
    change = top - np.hstack([np.eye(n), np.zeros((n, n + m))])
    bottom = np.hstack([np.zeros((m, 2 * n)), np.eye(m) + dt * conducts]) - scale * pushed.T @ change
    return np.vstack([top, np.hstack([np.eye(n), np.zeros((n, n + m))]), bottom])


@pytest.mark.parametrize(
    "coupling, conductivity, above", [(0.02, 0.01, 1.03), (0.02, 4.0, 1.03), (0.5, 4.0, 1.1), (0.5, 1.0, None)]
)
def test_the_step_limit_is_safe_and_near(coupling, conductivity, above):
    """At the limit nothing grows; a little above it something does, where the step of one of the fields decides;
    steps above it are refused, and so is that of the solid alone.
    """
    lattice, sides = square(7), fh.Periodic()
    model = both(coupling=coupling, conductivity=conductivity)
    sim = fh.Simulation(lattice, model, sides)
    alone = fh.Simulation(lattice, model.elastic, sides)
    limit = sim.step_limit
    assert sim.dt == pytest.approx(min(limit / 2, sim.parts.near.coupling.dt)) and limit < alone.step_limit
    # the marginal modes of rigid motion are double: rounding splits them by its root
    assert np.abs(np.linalg.eigvals(update(lattice, model, sides, limit))).max() < 1 + 1e-6
    if above is not None:
        assert np.abs(np.linalg.eigvals(update(lattice, model, sides, above * limit))).max() > 1.01
    for dt in (1.001 * limit, alone.step_limit):
        with pytest.raises(fh.InputError, match="above the stable limit") as caught:
            fh.Simulation(lattice, model, sides, dt=dt)
        assert caught.value.key == "run.dt"


@pytest.mark.slow
@pytest.mark.parametrize("more", [{"material": "state-based", "poisson": 0.05}, MATERIALS["correspondence"]])
def test_the_step_limit_is_safe_for_states(more):
    """Just below it, noise keeps its energy for three hundred steps beside a hole, even if the dilatation softens."""
    lattice, more = square(15, body=BODY), {"material": "correspondence"} | more
    model = both(coupling=0.5, conductivity=STILL, **more)
    limit = fh.Simulation(lattice, model, fh.Free()).step_limit
    sim = fh.Simulation(lattice, model, fh.Free(), noise(lattice), dt=0.999 * limit)
    first = total(sim)
    sim.step(300)
    assert total(sim) == pytest.approx(first, rel=1e-11)
    assert np.nanmax(np.abs(sim.fields["u"])) < 5


def shock(coupling, coupled=True, spacing=0.5):
    """A half-space whose face is suddenly heated by one, with the same thermal strain for all couplings."""
    lattice = fh.Lattice(spacing, (-1.5 * spacing, 0.0), (40.0 - spacing / 2, 4 * spacing))
    solid = fh.Elastic(fh.Kernel(2 * spacing, exponent=1), young=5 / 6)  # so that P waves have the speed 1
    expansion = 1e-3
    beta = expansion * 3 * solid.bulk
    capacity = ZERO * beta**2 / (coupling * solid.p_modulus)
    heat = fh.Heat(fh.Kernel(2 * spacing), 1.0, capacity, capacity, "rk4")
    sides = {"x-": fh.Free(), "x+": fh.LatticePML(nodes=16), "y": fh.Periodic()}
    face = fh.Temperature("x-", ZERO + 1)
    model = fh.Thermoelastic(solid, heat, expansion, ZERO, coupled)
    return fh.Simulation(lattice, model, sides, constraints=[face], dt=0.1 * spacing)


@pytest.mark.slow
def test_small_coupling_is_that_of_a_temperature_by_itself():
    """The half-space that is suddenly heated: the difference is of first order in the coupling constant."""
    runs = [shock(coupling).run(15.0, progress=False) for coupling in (0.04, 0.02, 0.01, 1e-9)]
    alone = shock(1e-9, coupled=False).run(15.0, progress=False)
    for name in ("u", "T"):
        fields = [run.fields[name] for run in runs]
        size = np.abs(fields[-1] - ZERO * (name == "T")).max()
        apart = [np.abs(field - fields[-1]).max() for field in fields[:-1]]
        order = np.polyfit(np.log([0.04, 0.02, 0.01]), np.log(apart), 1)[0]
        assert 0.95 < order < 1.05
        assert np.abs(alone.fields[name] - fields[-1]).max() < 2e-3 * size  # its own, larger steps


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_run_goes_on_bit_for_bit(tmp_path, dtype):
    """From a checkpoint, and pickled: with bonds that break and a crack that opens."""
    import pickle

    lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    model = both(critical_stretch=5.5e-3, coupling=0.1)
    start = {"T": "300 + 0.2*exp(-(x**2 + y**2)/6)", "v": ["0.01*x*exp(-(x**2 + y**2)/20)", 0.0]}
    crack = fh.Crack([(-8.0, 4.5), (0.0, 4.5)], opens=12.0)
    sim = fh.Simulation(lattice, model, fh.Free(), start, cracks=[crack], dtype=dtype, balance=True)
    sim.step(17)
    sim.save(tmp_path / "state.h5")
    runs = [sim, fh.Simulation.restore(tmp_path / "state.h5"), pickle.loads(pickle.dumps(sim))]
    for run in runs:
        run.step(25)
    assert sim.broken_bonds > 0 and sim.fields["T"].dtype == np.float64
    for run in runs[1:]:
        assert run.energies() == sim.energies()
        for name, values in sim.fields.items():
            np.testing.assert_array_equal(run.fields[name], values)


def test_what_bonds_gave_to_the_temperature_comes_back_as_they_break():
    """A plate that is pulled to dust does not remember what its bonds took from the heat."""
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    model = both(conductivity=STILL, critical_stretch=1e-2)
    x, y = lattice.coordinates()
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": [0.009 * x, 0.0 * y], "v": [0.5 * x, 0.5 * y]})
    sim.step(40)
    dust = sim.fields["damage"] == 1
    assert dust.sum() > 100
    heat, strain = model.heat, 0.009  # the start is taken as it is, at the reference temperature
    stress = 2 * (model.elastic.lame + model.elastic.shear) * strain * (1 + model.elastic.poisson) * model.expansion
    expected = ZERO / heat.heat_capacity * stress
    inside = dust.copy()
    inside[[0, 1, -2, -1]], inside[:, [0, 1, -2, -1]] = False, False
    np.testing.assert_allclose(sim.fields["T"][inside] - ZERO, expected, rtol=1e-10)


@pytest.mark.slow
def test_layers_of_each_field_send_back_a_quarter_of_the_coupling_at_most():
    """At layers that the fields do not share, the solid changes from its adiabatic stiffness to the isothermal one:
    long waves see a step of the impedance by half of the coupling constant, shorter ones less.
    """
    coupling, returned = 0.02, []
    for width in (2.0, 4.0, 8.0):
        runs = []
        for half in (60.0, 160.0):
            sides = {name: {"x": fh.LatticePML(nodes=n), "y": fh.Periodic()} for name, n in (("u", 24), ("T", 16))}
            lattice = fh.Lattice(1.0, (-half, 0.0), (half, 4.0))
            start = {"u": [f"exp(-x**2/{2 * width**2})", 0.0]}
            model = both(coupling=coupling, conductivity=0.05)
            runs.append(fh.Simulation(lattice, model, sides, start, dt=0.4))
        near, far = (run.run(60.0, progress=False).fields["u"][0, :, 2] for run in runs)
        returned.append(np.abs(near - far[100:-100])[30:-30].max() / 0.5)  # per half of the pulse
    assert max(returned) < coupling / 4
    assert returned == sorted(returned)


@pytest.mark.slow
def test_noise_between_layers_does_not_grow():
    """Random displacements, velocities and temperatures, for thirty crossings, at 0.95 of the step limit."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (49.0, 49.0))
    start = noise(lattice)
    window = np.zeros(lattice.shape)
    window[20:-20, 20:-20] = 1
    start = {"u": start["u"] * window, "v": start["v"] * window, "T": ZERO + (start["T"] - ZERO) * window}
    model = both(coupling=0.3, conductivity=0.1)
    limit = fh.Simulation(lattice, model, fh.LatticePML(nodes=12)).step_limit
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=12), start, dt=0.95 * limit)
    sizes = []
    for _ in range(30):
        sim.run(sim.time + sim.crossing, progress=False, allow_unstable=True)
        sizes.append(np.abs(sim.fields["u"]).max())
    assert max(sizes[-5:]) < 0.5 * sizes[3] < 0.5 * sizes[0]  # as without coupling: long waves leave slowly in 2D


def test_what_is_given_by_field_comes_to_its_field():
    """Sides, sources, coefficients, cracks and conditions; what is given without a field applies to both."""
    model, crack = both(), fh.Crack([(3.0, 5.5), (7.0, 5.5)], factor=0.5)
    held, moved = fh.Temperature("x-", 310.0), fh.Prescribed(fh.Box((4.0, 4.0), (5.0, 5.0)), [0.0, 0.0])
    setup = fh.Setup(
        square(),
        model,
        {"u": fh.Free(), "T": {"x": fh.Free(), "y": fh.Periodic()}},
        {"u": [0.0, 0.0], "T": "300 + x"},
        {"T": ["sin(t)"], "u": [["cos(t)", 0.0]]},
        [crack],
        {"T": 2.0},
        constraints=[held, moved],
    )
    (load,) = setup.loads
    heat = load.temperature
    assert setup.model.material == "bond-based" and setup.model.warm and heat.model is model.heat
    assert (load.coupled, load.reference, load.expansion) == (True, ZERO, model.expansion)
    assert set(setup.boundary.values()) == {fh.Free()} and heat.boundary["y+"] == fh.Periodic()
    assert setup.constraints == (moved,) and heat.constraints == (held,)
    assert (setup.cracks[0].factor, heat.cracks[0].factor) == (0.0, 0.5)
    assert setup.coefficient is None and heat.coefficient == 2.0
    assert heat.background == ZERO and len(heat.sources) == len(setup.sources) == 1
    plain = fh.Setup(square(), model, fh.Free())
    assert plain.boundary == plain.loads[0].temperature.boundary
    fh.Simulation.of(fh.Setup(**setup.arguments)).step(2)  # a set-up can be made from its own arguments


def thermoelastic(**changes):
    solid, heat = fh.Elastic(BONDS, young=1.0), fh.Heat(FAMILY)
    return fh.Thermoelastic(**{"elastic": solid, "heat": heat, "expansion": 1e-3, "reference": ZERO} | changes)


def simulated(**changes):
    return fh.Simulation(**{"lattice": square(), "model": thermoelastic(), "boundary": fh.Free()} | changes)


def of_load(temperature, **changes):
    load = fh.ThermalLoad(temperature, **{"expansion": 1e-3, "reference": ZERO, "coupled": True} | changes)
    return fh.Simulation(square(), fh.Elastic(BONDS, young=1.0), fh.Free(), loads=[load])


def heat_of(lattice):
    return fh.Setup(lattice, fh.Heat(FAMILY), fh.Free(), background=ZERO)


BAD = {
    "an expansion": ("model.expansion", lambda: thermoelastic(expansion=None)),
    "a reference": ("model.reference", lambda: thermoelastic(reference=None)),
    "a positive reference": ("model.reference", lambda: thermoelastic(reference=-10.0)),
    "an elastic solid": ("model.elastic", lambda: thermoelastic(elastic=fh.Wave(BONDS))),
    "a heat": ("model.heat", lambda: thermoelastic(heat=fh.Diffusion(FAMILY))),
    "a solid that heat strains": (
        "model.elastic",
        lambda: thermoelastic(elastic=fh.Elastic(BONDS, 1.0, nonlinear=True)),
    ),
    "finite elements": (
        "model.elastic",
        lambda: thermoelastic(elastic=fh.Elastic(young=1.0, poisson=0.3, material="finite-element"), coupled=False),
    ),
    "without contact": ("model.coupled", lambda: thermoelastic(elastic=fh.Elastic(BONDS, 1.0, contact=True))),
    "a field": ("boundary", lambda: simulated(boundary={"u": fh.Free(), "heat": fh.Free()})),
    "a coefficient by field": ("coefficient", lambda: simulated(coefficient=2.0)),
    "a side": ("heat.boundary", lambda: simulated(boundary={"u": fh.Free(), "T": {"z": fh.Free()}})),
    "an initial field": ("initial", lambda: simulated(initial={"w": 1.0})),
    "one temperature": ("load[1]", lambda: simulated(loads=[fh.ThermalLoad(300.0, 1e-3, ZERO)])),
    "a cold layer": (
        "load.temperature",
        lambda: simulated(
            initial={"T": "300 + exp(-4*(x - 2)**2)"},
            boundary={name: {"x": fh.LatticePML(nodes=n), "y": fh.Free()} for name, n in (("u", 8), ("T", 9))},
        ),
    ),
    "cold beyond it": ("initial.T", lambda: simulated(initial={"T": 310.0}, boundary=fh.LatticePML(nodes=8))),
    "a step": ("run.dt", lambda: simulated(dt=10.0)),
    "a run": ("load.temperature", lambda: of_load(310.0)),
    "no looks": ("load.every", lambda: of_load(heat_of(square()), every=1.0)),
    "the same nodes": ("load[0].temperature", lambda: of_load(heat_of(square(9)))),
    "a capacity": ("load[0].temperature", lambda: of_load(fh.Setup(square(), fh.Diffusion(FAMILY), fh.Free()))),
    "values beyond a wall": (
        "load.temperature",
        lambda: simulated(constraints=[fh.Temperature("x-", 310.0, kind="mirror")]),
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input(what):
    key, make = BAD[what]
    with pytest.raises(fh.InputError) as caught:
        make()
    assert caught.value.key == key
    assert caught.value.remedy or caught.value.limit
