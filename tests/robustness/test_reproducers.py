"""Inputs that once caused a traceback, a crash or an endless loop: refused in one line, or run."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

LINE = {"spacing": "0.25", "lower": "[-3.0]", "upper": "[3.0]"}
PULSE = "max(0, 1-4*x**2)**2"


def case(lattice=LINE, model='{ type = "wave", kernel = { horizon = 0.75 } }', u=PULSE, until="2.0", more=""):
    words = ", ".join(f"{name} = {value}" for name, value in lattice.items())
    return f'lattice = {{ {words} }}\nmodel = {model}\ninitial = {{ u = "{u}" }}\nrun = {{ until = {until} }}\n{more}'


PLANE = {"spacing": "0.25", "lower": "[-3.0, -3.0]", "upper": "[3.0, 3.0]"}
BOND = '{{ type = "elastic", young = 1.0, kernel = {{ horizon = {0}, exponent = 1 }} }}'
REFUSED = {
    "weights that are all zero": case(model='{ type = "wave", kernel = { horizon = 0.25, influence = "linear" } }'),
    "a state-based material without weights": case(
        {"spacing": "0.3333333333333333", "lower": "[-3.0, -3.0]", "upper": "[3.0, 3.0]"},
        u='["0", "0"]'.replace('"', "'"),
        model='{ type = "elastic", material = "state-based", young = 1.0, poisson = 0.2, kernel = { horizon = 0.4, '
        "exponent = 0, "
        'influence = "linear" } }',
    ),
    "a number of 5000 digits": case(until="1" * 5000),
    "brackets in brackets": case(more="output = { probes = " + "[" * 3000 + "]" * 3000 + " }"),
    "a crack without points": case(more="crack = [{ points = [] }]"),
    "a layer of 1e20 nodes": case(more='boundary = { all = { type = "lattice-pml", nodes = 100000000000000000000 } }'),
    "a probe far away": case(more="output = { probes = [[-1e308]] }"),
    "a speed whose square overflows": case(model='{ type = "wave", speed = 1e200, kernel = { horizon = 0.75 } }'),
    "a width whose square overflows": case(
        model='{ type = "wave", kernel = { horizon = 0.75, influence = "gaussian", width = 1e199 } }'
    ),
    "an exact end to the end of days": case(until="1e199", more='boundary = { all = { type = "exact" } }'),
    "a lattice of 1e15 nodes with a load": case(
        {**PLANE, "spacing": "1e-15"},
        BOND.format("2e-15"),
        "0",
        more='load = [{ type = "traction", side = "x-", value = [1.0, 0.0] }]',
    ),
    "outputs a billion times a step": case(more="output = { every = 1e-12 }"),
    "a time step of 1e-300": case(until="2.0, dt = 1e-300"),
    "exact ends with several stages": case(
        model='{ type = "diffusion", integrator = "rkc", kernel = { horizon = 0.75 } }',
        more='boundary = { all = { type = "exact" } }',
    ),
}


@pytest.mark.parametrize("text", REFUSED.values(), ids=REFUSED)
def test_refused_in_a_line_of_some_length(text):
    with pytest.raises(fh.InputError) as caught:
        made = Case(text)
        run = made.run()
        run.prepare(made.parts.run.until)
        made.every(run.dt)
    assert len(str(caught.value)) < 1500


def test_long_texts_are_cut_in_messages():
    with pytest.raises(fh.InputError) as caught:
        Case(case(u="x" * 20_000))
    assert len(str(caught.value)) < 1000


def test_dollars_are_letters_in_a_drawn_text():
    """A pair of dollar signs does not delimit mathematics: "$x$" is more than twice as wide as "x"."""
    for text in (r"$\frac$", "$5 and $6"):
        assert np.isfinite(fh.Text(text, 1.0).bounds()).all()
    assert np.ptp(fh.Text("$x$", 1.0).bounds(), axis=0)[0] > 2 * np.ptp(fh.Text("x", 1.0).bounds(), axis=0)[0]


@pytest.mark.parametrize("horizon", ["0.375", "0.75"])
def test_check_of_an_overdamped_wave(horizon):
    made = Case(
        case(
            model=f'{{ type = "wave", damping = 10.0, kernel = {{ horizon = {horizon} }} }}',
            more='boundary = { all = { type = "sponge", nodes = 4 } }',
        )
    )
    assert "stability" in str(made.run().check(2.0, 0.5))


@pytest.mark.parametrize("every", [-1.0, 0.0, float("nan"), float("inf"), 1e-320, "1"])
def test_times_between_outputs_that_are_none(every):
    sim = fh.Simulation(fh.Lattice(0.25, -3, 3), fh.Wave(fh.Kernel(0.75)), fh.LatticePML(nodes=6))
    with pytest.raises(fh.InputError):
        sim.run(1.0, every=every)


def test_whole_numbers_of_any_kind_are_one():
    """4 as a Python or NumPy integer gives the same layers; fractions are refused."""
    fields = []
    for nodes in (4, np.uint8(4), np.int8(4), np.int64(4)):
        for kind in (fh.Sponge, fh.LatticePML):
            sim = fh.Simulation(
                fh.Lattice(0.25, -3, 3),
                fh.Wave(fh.Kernel(0.75)),
                kind(nodes=nodes),
                {"u": lambda x: np.maximum(0, 1 - 4 * x**2) ** 2},
            )
            fields.append(sim.run(2.0).fields["u"])
    for k in (0, 1):
        assert all(np.array_equal(fields[k], other) for other in fields[k::2])
    for kind in (fh.Sponge, fh.LatticePML):
        with pytest.raises(fh.InputError):
            kind(nodes=4.5)


def test_complex_data_are_refused():
    with pytest.raises(fh.InputError):
        fh.Simulation(fh.Lattice(0.25, -3, 3), fh.Wave(fh.Kernel(0.75)), fh.Fixed(), {"u": np.ones(25) * 1j})


@pytest.mark.parametrize("lattice", [LINE, PLANE], ids=["line", "plane"])
def test_a_case_without_probes(lattice):
    made = Case(case(lattice, u="0"))
    run = made.run()
    assert len(run.record(made.parts.output.probes, made.parts.output.probe_every).nodes) == 0


def test_corrosion_beside_a_layer_that_is_chosen():
    """The specimen is placed before the layer, beyond which it may not extend, exists."""
    lattice = fh.Lattice(0.25, (-3.0, -3.0), (3.0, 3.0))
    model = fh.Corrosion(fh.Kernel(0.5), saturation=0.9)
    beside = fh.LatticePML(target=1e-6)
    run = fh.Simulation(lattice, model, beside, specimens=[fh.Specimen(fh.Disc(1.0))]).run(0.1)
    assert np.isfinite(run.fields["u"]).all()
    with pytest.raises(fh.InputError):
        fh.Simulation(lattice, model, beside, specimens=[fh.Specimen(fh.Disc(3.2))])


@pytest.mark.parametrize("value", [1e200, -1e300])
def test_data_whose_energy_overflows_are_refused(value):
    """A constant field stretches no bond: the run was finite, but its energy was not."""
    lattice = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))
    kernel = fh.Kernel(2.0, 0, "gaussian")
    setups = {
        "correspondence": lambda: fh.Simulation(
            lattice, fh.Correspondence(kernel, 1.0, 0.25, drag=0.1), fh.Fixed(), {"u": [0.0, value]}
        ),
        "simulation": lambda: fh.Simulation(lattice, fh.Elastic(kernel, young=1.0), initial={"v": [0.0, value]}),
    }
    for make in setups.values():
        with pytest.raises(fh.InputError, match=r"energy, overflow.*remedy: other units"):
            make()


def test_a_horizon_far_beyond_the_near_field_is_refused_at_once(monkeypatch):
    """It took minutes to find the modes of a stencil that reaches 108 nodes before it turned out not to fit."""

    def searched(*_):
        raise AssertionError("modes were looked for")

    monkeypatch.setattr("farhorizon.analysis.layers.profiles._evanescent_modes", searched)
    lattice, model = fh.Lattice(1.0, (-7.0, -7.0), (7.0, 7.0)), fh.Wave(fh.Kernel(108.0, influence="linear"))
    with pytest.raises(fh.InputError, match="the near field is thinner than the stencil; value: 15 nodes along x"):
        fh.Simulation(lattice, model, fh.LatticePML(target=1e-6))


@pytest.mark.parametrize("young", [5e-324, 1e-200, "1e100*(x + 9)"])
def test_constants_of_a_body_that_vanish_or_overflow_are_refused(young):
    """The wave speed was zero, and was a divisor."""
    lattice, kernel = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0)), fh.Kernel(2.0, 0, "gaussian")
    with pytest.raises(fh.InputError, match=r"model.young: is beyond what can be computed with.*1e-60 to 1e\+60"):
        model = fh.Correspondence(kernel, young, 0.25, critical_stretch=0.2)
        fh.Simulation(lattice, model, fh.Fixed(), cracks=[[(1.5, -1.5), (1.5, 1.5)]])
