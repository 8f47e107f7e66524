"""Correspondence elasticity: against a program with a matrix entry a bond, the infinite lattice by FFT, linear fields,
and its own energies.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from farhorizon import (
    Expression,
    Fixed,
    Free,
    InputError,
    Kernel,
    Lattice,
    NonlocalPML,
    Sponge,
    UnstableError,
    WholeSteps,
)
from farhorizon.body.body import Body, lame_constants
from farhorizon.body.infinite_body import InfiniteBody
from farhorizon.inputs.loads import BodyForce, Traction
from solids import KERNELS, MATERIAL, Dense, box, noise

SHAPES = [((9, 8), "gaussian"), ((9, 8), "constant"), ((8, 9), "ramp"), ((4, 4, 5), "constant")]


@pytest.mark.parametrize(("shape", "name"), SHAPES)
@pytest.mark.parametrize("side", [Free(), Fixed()])
@pytest.mark.parametrize("stabilisation", [0.0, 0.4])
def test_steps_match_dense_matrices(shape, name, side, stabilisation):
    """Free and fixed sides, with and without stabilisation: displacements after ten steps to rounding."""
    u = noise(shape, 0.01)
    dense = Dense(shape, KERNELS[name], 0 if isinstance(side, Free) else 2, stabilisation=stabilisation)
    dense.start(u)
    body = Body(
        box(*shape), KERNELS[name], **MATERIAL, boundary=side, initial={"u": u}, dt=0.1, stabilisation=stabilisation
    )
    assert (
        np.abs(
            body.gradient.reshape(len(shape) ** 2, -1) - dense.gradient()[dense.inside].reshape(-1, len(shape) ** 2).T
        ).max()
        < 1e-14
    )
    dense.step(10)
    body.step(10)
    assert np.abs(body.u - dense.field(dense.u)).max() < 1e-14
    assert np.abs(body.v - dense.field(dense.v)).max() < 1e-14


@pytest.mark.parametrize(
    ("shape", "name", "points"),
    [
        ((10, 9), "gaussian", [(4.5, -1.0), (4.5, 5.0)]),
        ((10, 9), "constant", [(2.0, 3.6), (7.0, 3.6)]),
        ((5, 6, 5), "constant", [(2.5, -1, -1), (2.5, 9, -1), (2.5, 9, 2.2), (2.5, -1, 2.2)]),
    ],
)
@pytest.mark.parametrize("kept", [False, True])
def test_damage_matches_dense_matrices(shape, name, points, kept):
    """Cracks, bonds that break, drag and a load together: the same bonds break at the same steps."""
    flat = np.array(points, float)
    axis = int(np.argmin(np.ptp(flat, axis=0)))
    place = flat[0, axis]
    other = [a for a in range(len(shape)) if a != axis]

    def absent(a, b):
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (place - a[..., axis]) / (b[..., axis] - a[..., axis])
        at = a + np.nan_to_num(share, posinf=0, neginf=0)[..., None] * (b - a)
        inside = [(at[..., o] >= flat[:, o].min()) & (at[..., o] <= flat[:, o].max()) for o in other]
        return (a[..., axis] < place) & (b[..., axis] > place) & np.all(inside, 0) | (a[..., axis] > place) & (
            b[..., axis] < place
        ) & np.all(inside, 0)

    u, v = noise(shape, 0.01), noise(shape, 0.05, 2)
    dense = Dense(shape, KERNELS[name], absent=absent, drag=0.5, critical=0.12, kept=kept)
    dense.start(u, v)
    body = Body(
        box(*shape),
        KERNELS[name],
        **MATERIAL,
        boundary=Free(),
        initial={"u": u, "v": v},
        dt=0.1,
        cracks=[points],
        drag=0.5,
        critical_stretch=0.12,
        shape_tensor="kept" if kept else "recomputed",
        loads=[BodyForce([0.02, *[0.0] * (len(shape) - 1)])],
    )
    cut = int((dense.w > 0).sum())
    dense.step(60, load=0.02)
    body.step(60)
    lost = cut - int((dense.w > 0).sum())
    assert lost > 10 and body.broken_bonds == lost // 2
    assert np.abs(body.u - dense.field(dense.u)).max() < 1e-12
    expected = 1 - (dense.w > 0).sum(1) / (dense.uncut > 0).sum(1)
    assert np.abs(body.damage() - dense.field(expected[:, None])[0]).max() < 1e-14


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("shape", [(12, 11), (6, 6, 7)])
def test_linear_displacements_are_exact_everywhere(shape, name):
    """At edges, corners, beside a crack and a hole: K of the bonds that are left."""
    slope = np.random.default_rng(2).standard_normal((len(shape),) * 2)
    lattice = box(*shape)
    crack = [[(5.5, -1.0), (5.5, 4.0)]] if len(shape) == 2 else []
    values = [sum(s * x for s, x in zip(row, lattice.coordinates(), strict=True)) for row in slope]
    body = Body(lattice, KERNELS[name], **MATERIAL, boundary=Free(), initial={"u": values}, cracks=crack)
    # rounding of values up to 30
    assert np.abs(body.gradient - slope.reshape(*slope.shape, *[1] * len(shape))).max() < 2e-13


@pytest.mark.parametrize(("half", "dim", "name"), [(30, 2, "gaussian"), (30, 2, "constant"), (13, 3, "gaussian")])
def test_infinite_lattice(half, dim, name):
    """Until the sides have sent something back, in the middle: the exact propagation in Fourier space."""
    lattice = box(*[2 * half + 1] * dim, lower=-half)
    rng = np.random.default_rng(3)
    u = np.zeros((dim, *lattice.shape))
    middle = tuple(slice(half - 2, half + 3) for _ in range(dim))
    u[(slice(None), *middle)] = rng.standard_normal((dim, *[5] * dim))
    body = Body(lattice, KERNELS[name], **MATERIAL, initial={"u": u}, dt=0.3)
    steps = int(0.6 * half / 0.3)
    exact = InfiniteBody(body.stencil, 1.0, body.fast, body.slow, 0.3, steps, u)
    body.step(steps)
    # what is ahead of the front falls faster than exponentially
    assert np.abs((body.u - exact.after(steps))[(slice(None), *middle)]).max() < 1e-9


def test_threads_agree():
    """Two threads do what one does, to the last bit."""
    fields = []
    for threads in (1, 2):
        body = Body(
            box(90, 80),
            KERNELS["gaussian"],
            **MATERIAL,
            boundary={"all": NonlocalPML(8), "y+": Free()},
            threads=threads,
            drag=0.1,
            initial={"u": noise((90, 80), 0.01), "v": noise((90, 80), 0.1, 2)},
            critical_stretch=0.08,
        )
        body.step(20)
        fields.append((body.u, body.damage()))
    assert body.broken_bonds > 0
    assert all((a == b).all() for a, b in zip(*fields, strict=True))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"stabilisation": 0.5},
        {"drag": 0.2},
        {"critical_stretch": 0.06},
        {"critical_stretch": 0.06, "shape_tensor": "kept"},
        {"stabilisation": 0.5, "drag": 0.2, "critical_stretch": 0.06},
    ],
)
@pytest.mark.parametrize("sides", [{"all": Free(), "x-": Fixed()}, {"all": NonlocalPML(6), "y+": Free()}])
def test_energies_balance(options, sides):
    """Kinetic and strain energy change by the work less what breaking, drag and the sides have taken, to rounding."""
    body = Body(
        box(20, 24),
        KERNELS["gaussian"],
        **MATERIAL,
        boundary=sides,
        dt=0.2,
        balance=True,
        initial={"u": noise((20, 24), 0.006), "v": noise((20, 24), 0.06, 2)},
        cracks=[[(9.5, 12.0), (9.5, 30.0)]],
        loads=[BodyForce([0.01, 0.0], lambda t: np.sin(t)), Traction("y+", (0.0, -0.02), [(3.0, 15.0)])],
        **options,
    )
    body.step()
    start = body.energies()
    assert start["work"] == start["broken"] == start["drag"] == start["outflow"] == 0
    body.step(150)
    now = body.energies()
    change = sum(now[name] - start[name] for name in ("kinetic", "strain"))
    moved = start["kinetic"] + start["strain"] + abs(now["work"])
    assert abs(change - now["work"] + now["broken"] + now["drag"] + now["outflow"]) < 1e-12 * moved
    assert (body.broken_bonds > 0) == ("critical_stretch" in options)
    assert now["work"] != 0


def test_strain_energy_is_that_of_the_books():
    """The strain energy of the fields at rest is the first one of the balance."""
    body = Body(box(20, 20), KERNELS["constant"], **MATERIAL, initial={"u": noise((20, 20), 0.01)})
    fields = body.strain_energy()
    body.step()
    assert body.energies()["strain"] == pytest.approx(fields, rel=1e-13)


def test_plane_states():
    """Stress for a strain along x: (1 - nu) E / ((1 + nu)(1 - 2 nu)) in plane strain, E / (1 - nu^2) in plane
    stress."""
    for plane, modulus in (("strain", 1.2), ("stress", 16 / 15)):  # nu = 1/4
        lame, shear = lame_constants(1.0, 0.25, 2, plane)
        assert lame + 2 * shear == pytest.approx(modulus, rel=1e-14)


def test_zero_energy_mode():
    """A chequerboard has no gradient inside an intact body, and no energy unless it is stabilised."""
    x, y = np.meshgrid(np.arange(24), np.arange(24), indexing="ij")
    board = 0.01 * (-1.0) ** (x + y)
    plain, stabilised = (
        Body(box(24, 24), KERNELS["gaussian"], **MATERIAL, initial={"u": (board, board)}, stabilisation=s)
        for s in (0.0, 1.0)
    )
    assert np.abs(plain.gradient[:, :, 4:-4, 4:-4]).max() < 1e-15
    stabilised.step()
    assert stabilised.energies()["strain"] > 10 * plain.strain_energy()


def test_uniform_motion_feels_no_drag():
    """Drag pulls towards the mean of the neighbours, so a rigid motion is none of its business."""
    body = Body(box(12, 12), KERNELS["gaussian"], **MATERIAL, boundary=Free(), initial={"v": (1.0, 0.5)}, drag=1.0)
    body.step(40)
    assert np.abs(body.v - np.array([1.0, 0.5])[:, None, None]).max() < 1e-12


def test_no_bond_breaks_near_the_layers():
    """Within one reach of the layers and beyond the critical stretch nothing breaks; elsewhere it does."""
    body = Body(
        box(30, 30),
        KERNELS["gaussian"],
        **MATERIAL,
        boundary=NonlocalPML(8),
        critical_stretch=0.03,
        loads=[BodyForce(noise((30, 30), 0.05))],
    )
    body.step(60)
    damage, reach = body.damage(), body.stencil.reach[0]
    rim = np.ones((30, 30), bool)
    rim[reach:-reach, reach:-reach] = False
    assert damage[rim].max() == 0 and damage.max() > 0.1


@pytest.mark.parametrize(
    ("side", "options"), [(Free(), {}), (Fixed(), {}), (Free(), {"drag": 1.0}), (Free(), {"stabilisation": 0.5})]
)
def test_step_limit(side, options):
    """White noise stays where it was at 0.97 of the limit, free faces and a crack included, and is stopped at 1.25
    times the undamped one.
    """
    settings = {**MATERIAL, "boundary": side, "initial": {"u": noise((20, 18), 0.01)}, **options}
    if isinstance(side, Free):
        settings["cracks"] = [[(9.5, -1.0), (9.5, 9.0)]]
    half = Body(box(20, 18), KERNELS["gaussian"], **settings).dt
    body = Body(box(20, 18), KERNELS["gaussian"], **settings, dt=1.94 * half)
    body.step(3000)
    assert np.abs(body.gradient).max() < 0.2
    if "drag" not in options:
        body.dt = 2.5 * half
        with pytest.raises(UnstableError, match="unstable at step"):
            body.step(1500)


def test_cavity():
    """A hole: nodes outside the body neither move nor count."""
    from farhorizon import Box, Disc

    lattice = Lattice(1.0, (0, 0), (20, 20), body=Box((-1, -1), (21, 21)) - Disc(4.0, (10, 10)))
    body = Body(lattice, KERNELS["gaussian"], **MATERIAL, boundary=NonlocalPML(6), initial={"u": noise((21, 21), 0.01)})
    body.step(30)
    assert (body.u[:, ~lattice.mask] == 0).all() and np.abs(body.u[:, lattice.mask]).max() > 0
    now = body.energies()
    assert np.isfinite(list(now.values())).all()


def test_isolated_nodes_are_said():
    """A crack all around a node is allowed; the node keeps its velocity."""
    square = [(4.4, 4.4), (5.6, 4.4), (5.6, 5.6), (4.4, 5.6), (4.4, 4.4)]
    body = Body(
        box(11, 11), KERNELS["gaussian"], **MATERIAL, boundary=Free(), cracks=[square], initial={"v": (0.3, 0.0)}
    )
    assert "1 nodes without any bond" in body.notes[0]
    body.step(20)
    assert body.v[0, 5, 5] == pytest.approx(0.3, abs=1e-14) and body.damage()[5, 5] == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"poisson": 0.5}, "Poisson's ratio is out of range.*below 0.5.*0.49"),
        ({"poisson": -1.0}, "above -1"),
        ({"plane": "stress", "poisson": 1.0}, "below 1"),
        ({"plane": "bending"}, "unknown plane state"),
        ({"young": 0.0}, "Young's modulus"),
        ({"density": -1.0}, "density"),
        ({"critical_stretch": 0.0}, "critical_stretch"),
        ({"shape_tensor": "frozen"}, "recomputed, kept"),
        ({"drag": -1.0}, "drag"),
        ({"stabilisation": 2.0}, "stabilisation"),
        ({"dt": 5.0}, "the step is out of range.*remedy: dt ="),
        ({"drag": 10.0, "dt": 0.3}, "the step is out of range.*limit: 0.09"),
        ({"boundary": Fixed(1.0)}, "holds displacements at zero"),
        ({"boundary": {"all": NonlocalPML(5), "x-": NonlocalPML(5, cross=0.1)}}, "one form and one cross-damping"),
        ({"loads": [Traction("y+", (0.0, -1.0), [(5.0, 40.0)])]}, "the traction reaches beyond the near field"),
        ({"loads": [Traction("x-", (0.0, -1.0))]}, "acts on a free side"),
        ({"loads": [Traction("z+", (0.0, -1.0))]}, "unknown side"),
        ({"loads": [Traction("y+", (0.0,))]}, "one component an axis"),
        ({"loads": [BodyForce([0.0])]}, "one entry a component"),
        ({"loads": [BodyForce([np.nan, 0.0])]}, "must be finite"),
        ({"initial": {"w": (0.0, 0.0)}}, "unknown initial field"),
        ({"initial": {"u": (np.zeros(3), 0.0)}}, "lattice's shape"),
        ({"critical_stretch": 0.01, "loads": [Traction("y+", (0.0, -1.0))]}, "far below the first strain of the load"),
        (
            {"critical_stretch": 0.001, "initial": {"u": (lambda x, y: 0.01 * x, 0.0)}},
            "initial displacements stretch bonds",
        ),
        ({"boundary": {"all": NonlocalPML(6, form="split"), "y+": Free()}, "drag": 0.1}, "split fields carry"),
        (
            {"boundary": {"all": NonlocalPML(6), "y+": Free()}, "cracks": [[(12.0, 3.0), (40.0, 20.0)]]},
            "missing bonds in a layer",
        ),
    ],
)
def test_bad_input(change, words):
    settings = {**MATERIAL, "boundary": {"all": Fixed(), "y+": Free()}, **change}
    with pytest.raises(InputError, match=words):
        Body(box(16, 16), KERNELS["gaussian"], **settings)


def test_bad_lattice():
    with pytest.raises(InputError, match="two or three dimensions"):
        Body(box(16), KERNELS["gaussian"], **MATERIAL)


def test_strong_load_is_noted():
    """Above the critical stretch, but not by ten times: allowed, and said."""
    body = Body(
        box(16, 16),
        KERNELS["gaussian"],
        **MATERIAL,
        boundary={"all": Fixed(), "y+": Free()},
        critical_stretch=0.01,
        loads=[Traction("y+", (0.0, -0.05))],
    )
    assert "above the critical stretch" in body.notes[0]


def test_sponge_takes_energy():
    body = Body(
        box(16, 16),
        KERNELS["gaussian"],
        **MATERIAL,
        boundary=Sponge(20),
        balance=True,
        initial={"u": noise((16, 16), 0.01)},
    )
    body.step()
    start = body.energies()
    body.step(400)
    now = body.energies()
    assert now["outflow"] > 0.5 * (start["kinetic"] + start["strain"])


def breaking(strength=1.0, **options):
    """A half-space pressed at its face until bonds break."""
    lattice = Lattice(1.0, (-12, -16), (12, 0))
    push = Traction("y+", (0.0, -0.01), between=[(-5, 5)], time=lambda t: strength * min(t / 10, 1.0))
    settings = {
        "boundary": {"all": NonlocalPML(8, cross=0.1), "y+": Free()},
        "critical_stretch": 3e-3,
        "drag": 0.9,
        "balance": True,
        "loads": [push],
    }
    return Body(lattice, KERNELS["gaussian"], **{**MATERIAL, **settings, **options}), push


@pytest.mark.parametrize("form", ["displacement", "split"])
def test_a_saved_body_goes_on_bitwise(form, tmp_path):
    """Displacements, broken bonds, energies: the same as without the interruption, loaded into a new body or restored
    from the file alone.
    """
    if form == "split":
        settings = {
            **MATERIAL,
            "boundary": NonlocalPML(6, form="split"),
            "initial": {"u": noise((12, 12), 0.01)},
            "dt": 0.01,
        }
        body, again = (Body(box(12, 12), KERNELS["gaussian"], **settings) for _ in range(2))
        changes = {}
    else:
        (body, push), (again, _) = breaking(), breaking()
        changes = {"loads": [push]}
    body.step(70)
    body.save(tmp_path / "a.ckpt", outputs=3)
    body.step(40)
    assert form == "split" or body.broken_bonds > 0
    assert again.load(tmp_path / "a.ckpt") == {"outputs": 3}
    restored = Body.restore(tmp_path / "a.ckpt", **changes)
    for other in (again, restored):
        assert other.time == 70 * other.dt
        other.step(40)
        for name, field in body.fields.items():
            np.testing.assert_array_equal(other.fields[name], field)
        assert other.energies() == body.energies() and other.broken_bonds == body.broken_bonds
    with pytest.raises(InputError, match="another set-up"):
        Body(box(12, 12), KERNELS["gaussian"], **MATERIAL).load(tmp_path / "a.ckpt")
    if changes:
        with pytest.raises(InputError, match="cannot hold a Python function"):
            Body.restore(tmp_path / "a.ckpt")


def test_balance_of_a_run_from_its_first_step():
    """Gains, work, breaking, drag and outflow add up at every output; at the start all are zero and the energy is that
    of the data.
    """
    body, _ = breaking(initial={"u": (Expression("1e-4*exp(-(x**2+(y+8)**2)/8)", 2), 0.0)}, dt=WholeSteps(every=5.0))
    first = body.energy()
    assert 0 < body.strain_energy() - first < 0.05 * first  # at rest v_before . v_after / 2 is -(a dt)^2 / 8
    assert set(body.balance().values()) == {0.0}
    residuals = []
    body.observers.append(lambda run: residuals.append(run.balance()["residual"]))
    body.run(60.0, every=5.0, progress=False)
    assert len(residuals) == 12 and body.broken_bonds > 0
    assert np.abs(residuals).max() < 1e-12 * abs(body.balance()["work"])


def test_check():
    """Facts, and what is known of the stability of the linear form: a proof without layers, growth of the split form
    and of the Heaviside kernel.
    """
    pinned = Body(box(12, 12), KERNELS["gaussian"], **MATERIAL, boundary={"x": Fixed(), "y": Sponge(5)})
    report = pinned.check(until=10.0)
    assert report.certificate.verdict == "certified" and report.numbers["step_limit"] == pinned.step_limit
    before = pinned.u
    assert report.numbers["steps"] == np.ceil(10 / pinned.dt) and pinned.step_count == 0 and (pinned.u == before).all()
    split = Body(box(12, 12), KERNELS["gaussian"], **MATERIAL, boundary=NonlocalPML(4, form="split"), dt=0.01)
    assert split.certificate().rate == pytest.approx(split.largest_frequency**2 * 0.01 / 2)
    strong = Body(
        box(12, 12), Kernel(3.1, 0, volume="full"), **MATERIAL, boundary=NonlocalPML(10, "quadratic", strength=1.5)
    )
    found = strong.check(budget=20.0)
    assert found.certificate.verdict == "not certified" and "cross" in found.warnings[0]


def test_loads_must_be_finite():
    with pytest.raises(InputError, match=r"load\.time"):
        breaking(strength=np.nan)


@pytest.mark.slow
def test_the_process_that_compiles_computes_what_later_ones_do(tmp_path):
    """To the last bit, or a run whose first half compiled would not resume to the same result."""
    case = Path(__file__).parents[2] / "examples" / "indentation.toml"
    code = (
        "import sys; from farhorizon.case.case import Case; run = Case.read(sys.argv[1]).run(); run.step(20); "
        "sys.stdout.write(''.join(field.tobytes().hex() for field in run.fields.values()))"
    )
    places = {"FARHORIZON_CACHE": str(tmp_path / "cache"), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", code, str(case)], env=os.environ | places, check=True, capture_output=True, text=True
        ).stdout
        for _ in range(2)
    )
    assert first == second
