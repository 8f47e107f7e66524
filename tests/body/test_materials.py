"""Bodies of several materials: dense matrices, layers in uniform strain, transmission and reflection, energies, step,
layers, cases, bad input.
"""

import numpy as np
import pytest

from farhorizon import (
    Body,
    BodyForce,
    Box,
    Disc,
    Expression,
    Fixed,
    Free,
    InputError,
    Kernel,
    Lattice,
    NonlocalPML,
    Sponge,
    Traction,
    UnstableError,
)
from farhorizon.body.body import lame_constants
from farhorizon.case.case import Case
from helpers import fitted_rate
from solids import KERNELS, Dense, box, noise


def graded(*at):
    """Constants that vary everywhere, by tens of per cent: Young's modulus, Poisson's ratio, density."""
    wave = sum((a + 1) * x for a, x in enumerate(at))
    return 1 + 0.5 * np.sin(wave), 0.2 + 0.15 * np.cos(wave), 1.3 + 0.4 * np.sin(0.7 * wave)


def constants(shape):
    return dict(zip(("young", "poisson", "density"), graded(*box(*shape).coordinates()), strict=True))


@pytest.mark.parametrize(("shape", "name"), [((9, 8), "gaussian"), ((8, 9), "ramp"), ((4, 4, 5), "constant")])
@pytest.mark.parametrize("side", [Free(), Fixed()])
@pytest.mark.parametrize("stabilisation", [0.0, 0.4])
def test_steps_match_dense_matrices(shape, name, side, stabilisation):
    """Constants of each node, load, bonds that break and drag: displacements after 40 steps, and the same bonds."""
    u, v = noise(shape, 0.01), noise(shape, 0.05, 2)
    dense = Dense(
        shape,
        KERNELS[name],
        0 if isinstance(side, Free) else 2,
        stabilisation=stabilisation,
        drag=0.5,
        material=graded,
        critical=0.12 if isinstance(side, Free) and not stabilisation else 1e9,
    )
    dense.start(u, v)
    body = Body(
        box(*shape),
        KERNELS[name],
        **constants(shape),
        boundary=side,
        initial={"u": u, "v": v},
        dt=0.1,
        drag=0.5,
        stabilisation=stabilisation,
        critical_stretch=0.12 if dense.critical < 1 else None,
        loads=[BodyForce([0.02, *[0.0] * (len(shape) - 1)])],
    )
    dense.step(40, load=0.02)
    body.step(40)
    assert (body.broken_bonds > 0) == (dense.critical < 1)
    assert np.abs(body.u - dense.field(dense.u)).max() < 1e-12
    assert np.abs(body.v - dense.field(dense.v)).max() < 1e-12


@pytest.mark.parametrize("shape", [(20, 13), (14, 7, 8)])
def test_layers_stretched_along_themselves_are_at_rest(shape):
    """A patch test: with Poisson's ratio 0 a uniform strain along layers of any stiffness is in equilibrium, free faces
    along them included.
    """
    lattice = box(*shape)
    along, across = lattice.coordinates()[0], lattice.coordinates()[1]
    young = 1 + 3 * np.random.default_rng(1).random(shape[1])[across.astype(int)]
    stretched = [0.01 * along, *[0.0] * (len(shape) - 1)]
    body = Body(
        lattice, KERNELS["ramp"], young=young, poisson=0.0, density=young**2, boundary=Free(), initial={"u": stretched}
    )
    strained = body.strain_energy()
    body.step()
    middle = slice(4, -4)  # two reaches of 2 nodes from the ends
    assert np.abs(body.v[:, middle]).max() < 1e-15 and np.abs(body.v).max() > 1e-4
    assert strained == pytest.approx(0.5 * 0.01**2 * young.sum(), rel=1e-12)


#: Young's modulus, Poisson's ratio and density on either side of x = 0.
PAIR = {"young": (1.0, 3.0), "poisson": (0.2, 0.3), "density": (1.0, 2.0)}


@pytest.mark.parametrize("component", [0, 1], ids=["P", "S"])
def test_an_interface_reflects_and_transmits_by_impedance(component):
    """The part of wavenumber 2 of a normally incident pulse, R = (Z1 - Z2)/(Z1 + Z2) and T = 2 Z1/(Z1 + Z2) with Z =
    density times speed, to second order; the interface lies midway between nodes. Nothing from the faces along the way
    has come to the middle by then.
    """
    moduli = [lame_constants(PAIR["young"][i], PAIR["poisson"][i], 2) for i in (0, 1)]
    moduli = [lame + 2 * shear if component == 0 else shear for lame, shear in moduli]
    speed, impedance = (
        np.array([np.sqrt(m * rho**sign) for m, rho in zip(moduli, PAIR["density"], strict=True)]) for sign in (-1, 1)
    )
    exact = np.abs([impedance[0] - impedance[1], 2 * impedance[0]]) / impedance.sum()

    def pulse(x):
        return np.exp(-(((x + 2.5) / 0.6) ** 2))

    def part(values, x, k):
        return abs((values * np.exp(-1j * k * x)).sum())

    spacings, errors = [0.2, 0.1, 0.05], []
    half = 6.0 if component == 0 else 9.0
    for dx in spacings:
        lattice = Lattice(dx, (-7 + dx / 2, -half), (7 - dx / 2, half))
        u, v = [0.0, 0.0], [0.0, 0.0]
        u[component], v[component] = lambda x, y: pulse(x), lambda x, y: speed[0] * 2 * (x + 2.5) / 0.36 * pulse(x)
        body = Body(
            lattice,
            Kernel(2 * dx, 1),
            boundary=Free(),
            initial={"u": u, "v": v},
            stabilisation=0.5,
            **{name: lambda x, y, pair=pair: np.where(x < 0, *pair) for name, pair in PAIR.items()},
        )
        body.run(4.5 / speed[0], progress=False)
        x, middle = lattice.axes[0], body.u[component][:, lattice.shape[1] // 2]
        left, k = x < 0, 2.0
        back, on = (
            part(middle[left], x[left], k),
            part(middle[~left], x[~left], k * speed[0] / speed[1]) * speed[0] / speed[1],
        )
        errors.append(np.abs(np.array([back, on]) / part(pulse(x), x, k) - exact).max())
    assert fitted_rate(spacings, errors) > 1.8 and errors[-1] < 5e-3


@pytest.mark.parametrize("options", [{}, {"stabilisation": 0.5}, {"drag": 0.2, "critical_stretch": 0.06}])
@pytest.mark.parametrize(
    "sides", [{"all": Free(), "x-": Fixed()}, {"all": Fixed(), "y-": NonlocalPML(6), "y+": Free()}]
)
def test_energies_balance(options, sides):
    """To rounding, as in a body of one material."""
    along = Lattice(1.0, 0.0, 19.0).axes[0][:, None] + np.zeros(24)
    young, poisson, density = graded(along)
    body = Body(
        box(20, 24),
        KERNELS["gaussian"],
        young=young,
        poisson=poisson,
        density=density,
        boundary=sides,
        dt=0.2,
        balance=True,
        initial={"u": noise((20, 24), 0.006), "v": noise((20, 24), 0.06, 2)},
        loads=[BodyForce([0.01, 0.0], np.sin), Traction("y+", (0.0, -0.02), [(3.0, 15.0)])],
        **options,
    )
    body.step()
    start = body.energies()
    body.step(150)
    now = body.energies()
    change = sum(now[name] - start[name] for name in ("kinetic", "strain"))
    moved = start["kinetic"] + start["strain"] + abs(now["work"])
    assert abs(change - now["work"] + now["broken"] + now["drag"] + now["outflow"]) < 1e-12 * moved
    assert (body.broken_bonds > 0) == ("critical_stretch" in options) and now["work"] != 0


@pytest.mark.parametrize("stabilisation", [0.0, 0.5])
@pytest.mark.parametrize("side", [Free(), Fixed()])
def test_step_limit(side, stabilisation):
    """Noise stays where it was at 0.97 of the limit and explodes at 1.25 times it: a stiff inclusion and a light
    one."""
    lattice = box(24, 22)
    x, y = lattice.coordinates()
    settings = {
        "young": np.where(np.hypot(x - 7, y - 10) < 5, 6.0, 1.0),
        "poisson": 0.25,
        "density": np.where(x > 15, 0.3, 1.0),
        "boundary": side,
        "initial": {"u": noise((24, 22), 0.01)},
        "stabilisation": stabilisation,
    }
    half = Body(lattice, KERNELS["gaussian"], **settings).dt
    body = Body(lattice, KERNELS["gaussian"], **settings, dt=1.94 * half)
    body.step(3000)
    assert np.abs(body.gradient).max() < 0.2
    body.dt = 2.5 * half
    with pytest.raises(UnstableError):
        body.step(3000)


def test_layers_along_the_way_go_on_into_the_absorbing_layer():
    """A stiff layer between soft ones meets the side at right angles: less comes back than the layer is made for,
    1e-3."""

    def young(x, y):
        return np.where(np.abs(y) < 5, 3.0, 1.0)

    start = {"u": [lambda x, y: np.exp(-(x**2 + y**2) / 20), 0.0]}
    sides = {"x": NonlocalPML(20, reflection=1e-3), "y": Fixed()}
    near, far = (
        Body(
            Lattice(1.0, (-half, -40), (half, 40)),
            KERNELS["gaussian"],
            young=young,
            poisson=0.25,
            boundary=b,
            initial=start,
            dt=0.25,
        )
        for half, b in ((15, sides), (60, Fixed()))
    )
    for body in (near, far):
        body.step(220)
    assert np.abs(near.u - far.u[:, 45:-45]).max() < 1e-3


def test_a_body_with_a_hole_may_have_nothing_in_it():
    """Values where there are no nodes do not matter."""
    lattice = Lattice(1.0, (0, 0), (20, 20), body=Box((-1, -1), (21, 21)) - Disc(4.0, (10, 10)))
    young = np.where(lattice.mask, 1 + 0.1 * lattice.coordinates()[0], np.nan)
    body = Body(
        lattice, KERNELS["gaussian"], young=young, poisson=0.25, boundary=Free(), initial={"u": noise((21, 21), 0.01)}
    )
    body.step(20)
    assert np.isfinite(body.fields["u"][:, lattice.mask]).all() and np.isfinite(list(body.energies().values())).all()


def test_one_value_everywhere_is_one_material():
    """An array of one value runs as the number, to the last bit."""
    start = {"u": noise((12, 11), 0.01)}
    fields = []
    for young in (2.0, np.full((12, 11), 2.0), lambda x, y: 2 + 0 * x):
        body = Body(box(12, 11), KERNELS["gaussian"], young=young, poisson=0.25, boundary=NonlocalPML(6), initial=start)
        body.step(10)
        fields.append(body.u)
    assert (fields[0] == fields[1]).all() and (fields[0] == fields[2]).all()


def test_a_saved_body_goes_on_bitwise(tmp_path):
    """From the file alone."""
    body = Body(
        box(12, 11),
        KERNELS["gaussian"],
        **constants((12, 11)),
        boundary=Free(),
        initial={"u": noise((12, 11), 0.01)},
        balance=True,
    )
    body.step(20)
    body.save(tmp_path / "a.ckpt")
    body.step(20)
    again = Body.restore(tmp_path / "a.ckpt")
    again.step(20)
    assert (again.u == body.u).all() and again.balance() == body.balance()
    with pytest.raises(InputError, match="another set-up"):
        Body(box(12, 11), KERNELS["gaussian"], young=1.0, poisson=0.25, boundary=Free(), balance=True).load(
            tmp_path / "a.ckpt"
        )


def test_certificate_and_report():
    """Of the fastest material alone, or a proof."""
    along = box(14, 15).coordinates()[1]
    settings = {"young": 1 + (along > 7), "poisson": 0.25, "density": 1.0}
    closed = Body(box(14, 15), KERNELS["gaussian"], **settings, boundary=Fixed())
    assert closed.certificate().verdict == "certified"
    report = closed.check(until=1.0, budget=1.0)
    assert "wave speeds" in str(report) and "largest" in str(report)
    open_ = Body(box(14, 15), KERNELS["gaussian"], **settings, boundary={"x": NonlocalPML(4), "y": Fixed()})
    assert open_.remade(box(9, 9)).fast == pytest.approx(open_.fast)


CASE = """
[lattice]
spacing = 1.0
lower = [-12.0, -12.0]
upper = [12.0, 12.0]
[model]
type = "correspondence"
young = "1 + 0.5*(y > 0)"
poisson = 0.2
kernel = { horizon = 2.7, exponent = 0, influence = "gaussian", width = 0.9, volume = "full" }
[[material]]
region = { disc = { radius = 4.0 } }
young = "3 + 0.1*x"
density = 2.0
[initial]
u = ["exp(-(x**2+y**2)/8)", 0.0]
[boundary]
x = { type = "nonlocal-pml", nodes = 6 }
y = { type = "fixed" }
[run]
until = 10.0
"""


def test_a_case_with_regions():
    body = Case(CASE).run()
    body.run(10.0, progress=False)
    lattice = Lattice(1.0, (-12, -12), (12, 12))
    x, y = lattice.coordinates()
    disc = Disc(4.0).contains(np.stack([x, y], -1))
    same = Body(
        lattice,
        KERNELS["gaussian"],
        young=np.where(disc, 3 + 0.1 * x, 1 + 0.5 * (y > 0)),
        poisson=0.2,
        density=np.where(disc, 2.0, 1.0),
        boundary={"x": NonlocalPML(6), "y": Fixed()},
        initial={"u": [Expression("exp(-(x**2+y**2)/8)", 2), 0.0]},
        dt=body.dt,
    )
    same.run(10.0, progress=False)
    np.testing.assert_allclose(body.u, same.u, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('young = "1 + 0.5*(y > 0)"', 'young = "1 + t"', r"model.young: a material cannot depend on t"),
        (
            'young = "1 + 0.5*(y > 0)"',
            'young = "1 + 0.5*(x > 10)"',
            "varies along x within one reach of an absorbing side",
        ),
        ('young = "1 + 0.5*(y > 0)"', 'young = "y"', "Young's modulus must be finite and positive"),
        ("density = 2.0", "densty = 2.0", "did you mean 'density'"),
        ("density = 2.0", "density = -2.0", "density must be finite and positive"),
        ("density = 2.0", "poisson = 0.5", "Poisson's ratio is out of range.*0.5"),
        ("radius = 4.0", "radius = 4.0, centre = [40.0, 0.0]", r"material\[0\].region: the region has no node"),
        (
            "region = { disc = { radius = 4.0 } }",
            "region = { disc = { radius = 4.0 }, box = { lower = [0, 0], upper = [1, 1] } }",
            "exactly one of",
        ),
        ("nodes = 6 }", 'nodes = 6, form = "split" }', "split fields carry.*several materials"),
        ('type = "correspondence"', 'type = "elastic"', "boundary.x: not a boundary that serves here"),
    ],
)
def test_bad_cases(old, new, message):
    assert old in CASE
    with pytest.raises(InputError, match=message):
        Case(CASE.replace(old, new)).run()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"young": np.ones((3, 3))}, "lattice's shape"),
        ({"density": np.full((16, 16), np.nan)}, "must be finite"),
        (
            {"young": lambda x, y: np.where(x > 17, 2.0, 1.0), "boundary": Sponge(5)},
            "beyond an absorbing side is not that at the edge",
        ),
        ({"poisson": np.linspace(0.2, 0.6, 256).reshape(16, 16)}, "Poisson's ratio is out of range.*0.6"),
    ],
)
def test_bad_input(changes, message):
    with pytest.raises(InputError, match=message):
        Body(box(16, 16), KERNELS["gaussian"], **{"young": 1.0, "poisson": 0.25, **changes})
