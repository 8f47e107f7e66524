"""Displacements and a temperature that change each other, against dense numpy programs and the coupled plane wave."""

import numpy as np
import pytest

import farhorizon as fh

BONDS, FAMILY = fh.Kernel(2.0, exponent=1), fh.Kernel(2.0)
ZERO = 300.0  # reference temperature
STILL = 1e-30  # a conductivity that moves nothing


def both(coupling=0.2, conductivity=0.3, integrator="euler", capacity=2.0, kernel=BONDS, coupled=True, **more):
    """Models with a coupling constant ``T0 beta^2 / rho c M`` of the plane or of space."""
    solid = fh.Elastic(kernel, young=1.5, density=1.2, **more)
    dim = 3 if more.get("plane") is None else 2
    expansion = np.sqrt(coupling * capacity * solid.p_modulus / ZERO) / (dim * solid.lame + 2 * solid.shear)
    # the specific heat is per mass of the heat's own density
    heat = fh.Heat(fh.Kernel(kernel.horizon), 4.0, capacity / 4, conductivity, integrator)
    return fh.Thermoelastic(solid, heat, expansion, ZERO, coupled)


def noise(lattice, seed=0):
    """Initial data."""
    random = np.random.default_rng(seed)
    shape = (lattice.dim, *lattice.shape)
    return {
        "u": 0.1 * random.standard_normal(shape),
        "v": 0.1 * random.standard_normal(shape),
        "T": ZERO + random.standard_normal(lattice.shape),
    }


def total(sim):
    found = sim.energies()
    return found["kinetic"] + found["strain"] + found["thermal"]


def square(n=11, **more):
    return fh.Lattice(1.0, (0.0, 0.0), (n - 1.0, n - 1.0), **more)


BODY = fh.Box((-1.0, -1.0), (20.0, 20.0)) - fh.Disc(2.2, (7.0, 7.0))
SOLIDS = {
    "periodic": (square(), {}, fh.Periodic(), {}),
    "free": (square(), {"plane": "stress"}, fh.Free(), {}),
    "held": (square(23), {}, {"x": fh.Fixed(), "y": fh.Free()}, {}),
    "hole and crack": (square(15, body=BODY), {}, fh.Free(), {"cracks": [[(-1.0, 3.5), (8.0, 3.5)]]}),
    "in space": (fh.Lattice(1.0, (0.0,) * 3, (5.0,) * 3), {}, fh.Free(), {}),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_nothing_is_lost_without_conduction(name):
    """Kinetic and strain energy and that of the temperature add up to rounding, in noise, which moves ten orders more
    between them.
    """
    lattice, more, sides, others = SOLIDS[name]
    start = noise(lattice)
    if name == "held":  # bonds know of no heat there
        start["T"][:4], start["T"][-4:] = ZERO, ZERO
    sim = fh.Simulation(lattice, both(conductivity=STILL, **more), sides, start, **others)
    first, thermal, found = total(sim), sim.energies()["thermal"], []
    for _ in range(150):
        sim.step()
        found.append((total(sim), sim.energies()["thermal"]))
    sums, heats = np.array(found).T
    assert np.abs(sums - first).max() < 1e-13 * first
    assert np.abs(heats - thermal).max() > 1e-3 * first


@pytest.mark.slow
def test_nothing_is_lost_where_the_material_varies():
    """Stiffness, density and expansion from node to node: each bond pushes as it is pushed."""
    x, y = square().coordinates()
    solid = fh.Elastic(BONDS, young=1 + 0.5 * np.sin(x), density=1 + 0.3 * np.cos(y))
    heat = fh.Heat(FAMILY, conductivity=STILL)
    model = fh.Thermoelastic(solid, heat, 0.02 + 0.01 * np.cos(x + y), ZERO)
    sim = fh.Simulation(square(), model, fh.Free(), noise(square()))
    first = total(sim)
    sim.step(200)
    assert total(sim) == pytest.approx(first, rel=1e-13)


def dense(lattice, model, sides):
    """Matrices of a periodic or free square: acceleration and conduction, and heat's push and the trace, by bond."""
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
    """And the quadratic form that proves them stable never grows, in noise, with conduction."""
    lattice, model = square(7), both(conductivity=1.0, integrator=integrator)
    sim = fh.Simulation(lattice, model, sides, noise(lattice))
    of_u, pushed, conducts = dense(lattice, model, sides)
    dt, solid, heat = sim.dt, model.elastic, model.heat
    scale = solid.density * ZERO / heat.heat_capacity  # of the trace, the adjoint of the push
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
        np.testing.assert_allclose(sim.fields["T"].ravel() - ZERO, theta, rtol=0, atol=1e-11)  # of a sum with 300
    assert (np.diff(forms) < 1e-14 * forms[0]).all()
    assert forms[-1] < 0.9 * forms[0] and min(forms) > 0


def characteristic(model, sides_of, dt, k, spacing):
    """Coefficients of the polynomial of growth factors of a step, of P waves along x of a wavenumber."""
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
    """The amplitudes of u and T follow the recurrence of the characteristic equation on the lattice, to rounding."""
    n, plane = 24, "stress"
    lattice = fh.Lattice(1.0, (0.0, 0.0), (n - 1.0, 4.0))
    model = both(conductivity=conductivity, integrator="rk4", plane=plane)
    wave = np.exp(2j * np.pi * waves * np.arange(n) / n)
    start = {"u": [np.outer(wave.real, np.ones(5)), 0.0], "T": ZERO + 10 * np.outer(wave.imag, np.ones(5))}
    sim = fh.Simulation(lattice, model, fh.Periodic(), start)
    polynomial = characteristic(model, 2, sim.dt, 2 * np.pi * waves / n, 1.0)
    found = []
    for _ in range(60):
        fields = sim.fields
        found.append([(part[:, 2] * wave.conj()).mean() for part in (fields["u"][0], fields["T"] - ZERO)])
        sim.step()
    u, theta = np.array(found).T
    for amplitudes in (u, theta):
        left = sum(factor * amplitudes[3 - i : len(amplitudes) - i] for i, factor in enumerate(polynomial))
        assert np.abs(left).max() < 1e-12 * np.abs(amplitudes).max()
    assert np.abs(np.roots(polynomial)).max() < 1


def continuum(model, k, dim):
    """Rates of plane waves ``exp(s t)`` in the continuum: ``(s^2 + c^2 k^2)(s + D k^2) + e c^2 k^2 s = 0`` with the
    coupling constant e, the decaying one last.
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
    """Speed, attenuation, and the decay of what is left behind: of second order in the spacing."""
    errors, spacings = [], np.array([0.2, 0.1, 0.05])
    for spacing in spacings:
        model = both(
            conductivity=conductivity, integrator="rk4", kernel=fh.Kernel(2 * spacing, exponent=1), plane=plane
        )
        dt = 0.05 * spacing if conductivity < 1 else 0.2 * spacing**2  # of the conduction's limit
        rates = ordered(np.log(np.roots(characteristic(model, dim, dt, 1.0, spacing)).astype(complex)) / dt)
        exact = continuum(model, 1.0, dim)
        errors.append(np.abs(rates[[0, 1]] - exact[[0, 1]]) / np.abs(exact[[0, 1]]))
    orders = [np.polyfit(np.log(spacings), np.log(error), 1)[0] for error in np.array(errors).T]
    assert min(orders) > 1.9
    assert np.max(errors[-1]) < 1e-3
