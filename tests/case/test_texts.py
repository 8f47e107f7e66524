"""Texts in case files in place of functions: the run is the same as with the function."""

import numpy as np
import pytest

import farhorizon as fh

LINE = fh.Lattice(0.25, -5.0, 5.0)
PLANE = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0))
BLOCK = fh.Lattice(1.0, (-3.0, -3.0, -3.0), (3.0, 3.0, 3.0))
SIDES = fh.Free()


def gauss(*at):
    return np.exp(-2 * sum(x**2 for x in at))


def waves(**setup):
    return fh.Simulation(PLANE, fh.Wave(fh.Kernel(1.0)), SIDES, **setup)


def elastic(**setup):
    return fh.Simulation(PLANE, fh.Elastic(fh.Kernel(1.0, 1), 1.0), SIDES, **setup)


def body(**setup):
    solid = {name: setup.pop(name) for name in ("young", "density") if name in setup}
    solid = fh.Correspondence(fh.Kernel(1.0, 1), **{"young": 1.0, "poisson": 0.3, **solid})
    return fh.Simulation(PLANE, solid, fh.Fixed(), **setup)


def heat(condition):
    return fh.Simulation(LINE, fh.Heat(fh.Kernel(0.5)), SIDES, constraints=[condition])


# Each pair is the same set-up, once with a text and once with its equivalent in Python.
PAIRS = {
    "initial": (
        lambda: waves(initial={"u": "exp(-2*(x**2 + y**2))", "v": "x*exp(-2*(x**2 + y**2))"}),
        lambda: waves(initial={"u": gauss, "v": lambda x, y: x * gauss(x, y)}),
    ),
    "initial in space": (
        lambda: fh.Simulation(
            BLOCK, fh.Wave(fh.Kernel(1.0)), SIDES, {"u": fh.Expression("exp(-2*(x**2 + y**2 + z**2))")}
        ),
        lambda: fh.Simulation(BLOCK, fh.Wave(fh.Kernel(1.0)), SIDES, {"u": gauss}),
    ),
    "initial of a vector": (
        lambda: elastic(initial={"u": ["exp(-2*(x**2 + y**2))", 0.0]}),
        lambda: elastic(initial={"u": [gauss, 0.0]}),
    ),
    "source": (
        lambda: waves(sources=["exp(-2*(x**2 + y**2))*sin(3*t)"]),
        lambda: waves(sources=[fh.Source(gauss, lambda t: np.sin(3 * t))]),
    ),
    "moving source": (
        lambda: waves(sources=[fh.Expression("exp(-2*((x - t)**2 + y**2))")]),
        lambda: waves(sources=[lambda x, y, t: gauss(x - t, y)]),
    ),
    "time of a source": (
        lambda: waves(sources=[fh.Source("exp(-2*(x**2 + y**2))", "sin(3*t)")]),
        lambda: waves(sources=[fh.Source(gauss, lambda t: np.sin(3 * t))]),
    ),
    "coefficient": (
        lambda: waves(initial={"u": gauss}, coefficient="where(x < 0, 1, 0.5)"),
        lambda: waves(initial={"u": gauss}, coefficient=np.where(PLANE.coordinates()[0] < 0, 1, 0.5)),
    ),
    "body force": (
        lambda: elastic(loads=[fh.BodyForce(["exp(-2*(x**2 + y**2))", 0.0], "min(t, 1)")]),
        lambda: elastic(loads=[fh.BodyForce([gauss, 0.0], lambda t: min(t, 1.0))]),
    ),
    "traction": (
        lambda: elastic(loads=[fh.Traction("y+", (0.0, -1.0), [(-1.0, 1.0)], "sin(t)")]),
        lambda: elastic(loads=[fh.Traction("y+", (0.0, -1.0), [(-1.0, 1.0)], np.sin)]),
    ),
    "materials": (
        lambda: body(
            young="where(y < 0, 1, 2)", density="where(y < 0, 1, 3)", initial={"u": ["exp(-2*(x**2 + y**2))", 0.0]}
        ),
        lambda: body(
            young=lambda x, y: np.where(y < 0, 1, 2),
            density=lambda x, y: np.where(y < 0, 1, 3),
            initial={"u": [gauss, 0.0]},
        ),
    ),
    "force on a body": (
        lambda: body(loads=[fh.BodyForce(["exp(-2*(x**2 + y**2))", 0.0], "sin(t)")]),
        lambda: body(loads=[fh.BodyForce([gauss, 0.0], np.sin)]),
    ),
    "temperature": (
        lambda: heat(fh.Temperature("x-", "sin(t)")),
        lambda: heat(fh.Temperature("x-", lambda x, t: np.sin(t))),
    ),
    "flux": (lambda: heat(fh.Flux("x-", "1 + t")), lambda: heat(fh.Flux("x-", lambda x, t: 1 + t))),
    "ambient": (
        lambda: heat(fh.Convection("x-", 1.0, "20*cos(t)")),
        lambda: heat(fh.Convection("x-", 1.0, lambda x, t: 20 * np.cos(t))),
    ),
    "temperature inside": (
        lambda: heat(fh.Temperature(fh.Box(-1, 1), "x + t")),
        lambda: heat(fh.Temperature(fh.Box(-1, 1), lambda x, t: x + t)),
    ),
    "prescribed": (
        lambda: fh.Simulation(
            LINE, fh.Wave(fh.Kernel(0.5)), SIDES, constraints=[fh.Prescribed([0.0], "sin(t)", 0.5, "cos(t)")]
        ),
        lambda: fh.Simulation(
            LINE, fh.Wave(fh.Kernel(0.5)), SIDES, constraints=[fh.Prescribed([0.0], np.sin, 0.5, np.cos)]
        ),
    ),
}


@pytest.mark.parametrize("name", PAIRS)
def test_a_text_says_what_a_function_does(name, tmp_path):
    text, function = (make() for make in PAIRS[name])
    text.step(12)
    function.step(12)
    assert np.abs(function.fields["u"]).max() > 0
    assert np.allclose(text.fields["u"], function.fields["u"], rtol=0, atol=1e-13 * np.abs(function.fields["u"]).max())
    text.save(tmp_path / "a.ckpt")  # unlike a function, it is stored in a checkpoint
    initial = {"initial": {"u": ["exp(-2*(x**2 + y**2))", 0.0]}} if name == "materials" else {}
    assert np.array_equal(
        type(text).restore(tmp_path / "a.ckpt", **initial).fields["u"], text.fields["u"], equal_nan=True
    )


def test_an_incident_wave_takes_a_text():
    plane = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0))
    runs = [
        fh.Simulation(plane, fh.Wave(fh.Kernel(1.0)), sources=[fh.IncidentWave((1, 0), signal, 8.0)], dt=0.1)
        for signal in ("sin(pi*t/8)**4", lambda t: np.sin(np.pi * t / 8) ** 4)
    ]
    one, other = (run.run(until=8.0).fields["u"] for run in runs)
    assert np.abs(one).max() > 0.5 and np.allclose(one, other, rtol=0, atol=1e-13)


class TestWithoutDim:
    def test_takes_the_dimension_of_where_it_is_used(self):
        expression = fh.Expression("x*t")
        assert expression.dim is None and repr(expression) == "Expression('x*t')"
        assert expression(2.0, t=3.0) == expression(2.0, 5.0, t=3.0) == 6.0
        assert expression.on(2).dim == 2

    def test_of_time_alone_is_called_with_t(self):
        assert fh.Expression("sin(t)", 0)(1.0) == fh.Expression("sin(t)")(t=1.0) == np.sin(1.0)

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (
                lambda: waves(initial={"u": "exp(-z**2)"}),
                r"initial\.u: there is no z in 2 dimensions; value: "
                r"exp\(-z\*\*2\); remedy: use x, y$",
            ),
            (lambda: waves(initial={"u": fh.Expression("exp(-z**2)")}), r"initial\.u: there is no z in 2 dimensions"),
            (lambda: waves(initial={"u": "exp(-x**2)*t"}), r"initial\.u: cannot depend on t; .*remedy: use x, y$"),
            (
                lambda: waves(sources=["x", "exp(-q)"]),
                r"source\[1\]: unknown name 'q' in the expression; .*known: x, y, "
                r"t, pi, e",
            ),
            (lambda: waves(coefficient="t"), "coefficient: cannot depend on t"),
            (lambda: heat(fh.Flux("x-", "y")), r"constraint\[0\]\.value: there is no y in 1 dimensions"),
            (lambda: body(young="z"), r"model\.young: there is no z"),
            (
                lambda: fh.Traction("y+", (1.0, 0.0), None, "sin(x)"),
                r"load\.time: there is no x in a function of t alone",
            ),
            (
                lambda: fh.IncidentWave((1, 0), "sin(y)", 1.0),
                r"incident\.signal: there is no y in a function of t alone",
            ),
            (
                lambda: elastic(initial={"u": "exp(-x**2)"}),
                r"initial\.u: a vector field needs one entry per component; "
                r"value: one for all",
            ),
            (
                lambda: elastic(sources=["exp(-x**2)"]),
                "source: a vector field needs one entry per component; value: one for all; limit: a list of 2",
            ),
            (lambda: elastic(initial={"u": ["x", "y", "x"]}), "value: 3 entries; limit: a list of 2"),
        ],
    )
    def test_what_is_wrong_is_named(self, make, message):
        with pytest.raises(fh.InputError, match=message):
            make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: fh.Wave(fh.Kernel(1.0), speed=[1.0, 2.0]),
            r"model\.speed: must be a number; value: \[1, 2\].*a function or an array of the nodes",
        ),
        (
            lambda: fh.Elastic(fh.Kernel(1.0), young=1j),
            r"model\.young: must be a number; .*an expression, a function or an array",
        ),
        (
            lambda: fh.Lattice(0.5, (0, 0), (1, 1), body="disc"),
            r"lattice\.body: must be a shape; .*Mesh, Voxels, of a body an array of bool of the lattice's shape.*Shape",
        ),
        (
            lambda: fh.Lattice(0.5, (0, 0), (1, 1), body=OwnShape()),
            r"the function is called with points; .*remedy: a "
            r"function of 1 argument",
        ),
        (
            lambda: waves(initial={"u": "1/x"}),
            r"initial\.u: values must be finite; value: inf at \[0, -4\], and on 17 of "
            r"289 nodes in all",
        ),
        (
            lambda: waves(initial={"u": gauss}).run(until="soon"),
            r"run\.until: neither a time nor a state; value: the text 'soon'; limit: static",
        ),
    ],
)
def test_errors_of_python_speak_the_words_of_the_user(make, message):
    with pytest.raises(fh.InputError, match=message):
        make()


class OwnShape(fh.Disc):
    """A disc as a user wrote it, with separate coordinates as arguments."""

    def __init__(self):
        super().__init__(1.0)

    def contains(self, x, y, z):
        return x > 0


@pytest.mark.parametrize("place", [12.0, 20.0])
def test_data_outside_are_said_to_lie_outside(place):
    """The message does not merely say that one tiny number is above another."""
    setup = {"lattice": PLANE, "model": fh.Wave(fh.Kernel(1.0))}
    text = f"exp(-2*((x - {place})**2 + y**2))"
    with pytest.raises(
        fh.InputError,
        match=rf"initial\.u: lies outside the near field.* near \[{place:g}, 0\]; limit: \[-4, -4\] to \[4, 4\]",
    ):
        fh.Simulation(**setup, initial={"u": text})
    with pytest.raises(fh.InputError, match=rf"source: lies outside the near field.* near \[{place:g}, 0\]"):
        fh.Simulation(**setup, sources=[text + "*sin(t)"])
