"""Messages that users met when they tried the program: the worst, which were rewritten, and the best, which are kept.
Each test compares the new text, and makes sure that the old one does not return.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

PLANE = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0))
WAVE = """lattice = { spacing = 0.5, lower = [-4.0, -4.0], upper = [4.0, 4.0] }
model = { type = "wave", speed = 1.0, kernel = { horizon = 1.0 } }
initial = { u = "exp(-2*(x**2+y**2))" }
run = { until = 2.0 }
"""
UNITS = 'units = { length = "m", time = "s", mass = "kg" }\n'
ELASTIC = """lattice = { spacing = 0.5, lower = [-4.0, -4.0], upper = [4.0, 4.0] }
model = { type = "elastic", young = 1.0, kernel = { horizon = 1.0 } }
initial = { u = ["exp(-2*(x**2+y**2))", 0.0] }
run = { until = 2.0 }
"""


def case(text, old="", new="", more=""):
    """Return a function that reads and assembles a changed case."""
    assert old in text
    return lambda: Case((text.replace(old, new) if old else text) + more).simulation()


class PlainDisc(fh.Disc):
    """A disc as a user wrote it, with separate coordinates as arguments."""

    def contains(self, x, y, z):
        return x > 0


#: What is done, the new message, and a part of the old one.
WORST = {
    "speed by an array": (
        lambda: fh.Simulation(PLANE, fh.Wave(fh.Kernel(1.0), speed=np.ones((3, 3)))),
        r"model\.speed: an array must have the lattice's shape; value: \(3, 3\); limit: \(17, 17\)",
        "truth value",
    ),
    "own shape": (
        lambda: fh.Lattice(0.5, (0, 0), (1, 1), body=PlainDisc(1.0)),
        r"lattice: the function is called with points; .*remedy: a function of 1 argument",
        "positional",
    ),
    "a side that the material does not have": (
        case(
            ELASTIC,
            "young = 1.0, kernel = { horizon = 1.0 }",
            'young = 1.0, poisson = 0.3, material = "finite-element"',
            'boundary = { all = { type = "lattice-pml" }, "y+" = { type = "free" } }\n',
        ),
        r"boundary\.y\+: .* material has no such side; value: Free; .*remedy: .*free sides, bodies and cracks",
        "Elastic has no such side",
    ),
    "true for a number": (
        case(WAVE, "spacing = 0.5", "spacing = true"),
        r"lattice\.spacing: must be a number; value: True; .*remedy: such as 1\.5",
        "horizon",
    ),
    "true for a whole number": (
        case(WAVE, "horizon = 1.0", "horizon = 1.0, exponent = true"),
        r"kernel\.exponent: must be a whole number; value: True; .*remedy: such as 3",
        "horizon",
    ),
    "layer of another material": (
        lambda: fh.Simulation(PLANE, fh.Elastic(fh.Kernel(1.0), 1.0), fh.NonlocalPML(8)),
        r"boundary\.x-: Elastic of bond-based .* has no such side; .*remedy: with LatticePML or Sponge: free sides",
        "remedy: LatticePML",
    ),
    "a box of an incident wave too far out": (
        lambda: fh.Simulation(
            fh.Lattice(0.0002, (-0.0146, -0.0146), (0.0146, -0.0004)),
            fh.Wave(fh.Kernel(0.0004)),
            sources=[fh.IncidentWave((1, 0), "sin(t)", 1.0, within=fh.Box((-0.012, -0.012), (0.012, 0.0)))],
        ),
        r"incident\.within: the box .* along y: .*; value: -0\.012 to 0; limit: within -0\.0142 to -0\.0008; remedy",
        "np.float64",
    ),
    "a source wholly outside": (
        case(WAVE, more='[[source]]\nvalue = "exp(-2*((x-20)**2+y**2))*sin(t)"\n'),
        r"source: lies outside the near field.*; value: 1 near \[20, 0\]; limit: \[-4, -4\] to \[4, 4\]",
        "e-63",
    ),
    "a key far from all others": (
        case(ELASTIC, "young = 1.0", "speed = 1.0"),
        r"unknown key model\.speed; known: type, kernel, young, poisson",
        "did you mean 'type'",
    ),
    "a table far from all others": (
        case(WAVE, more="[medium]\na = 1\n"),
        "unknown key medium; known: units, lattice, model, material",
        "did you mean 'rim'",
    ),
    "one text for a displacement": (
        case(ELASTIC, '["exp(-2*(x**2+y**2))", 0.0]', '"exp(-x**2)"'),
        r"initial\.u: a vector field needs one entry per component; value: one for all; limit: a list of 2; remedy: \[",
        "entries",
    ),
    "a flat text for the source of a vector": (
        case(ELASTIC, more='[[source]]\nvalue = "exp(-x**2)*sin(t)"\n'),
        "source: a vector field needs one entry per component",
        "value: a number",
    ),
    "a load without a type": (
        case(ELASTIC, more='[[load]]\nside = "y+"\nvalue = [0.0, 1.0]\n'),
        r"load\[0\]\.type: the type is missing; limit: traction, body-force, impactor, pressure, thermal; "
        r"remedy: type = \"traction\"",
        "discriminator",
    ),
    "constants of a bond-based material": (
        case(ELASTIC, "young = 1.0, ", ""),
        "model: a bond-based material needs one modulus; value: none; limit: one of young, bulk, shear",
        "two constants",
    ),
    "values that are not finite": (
        case(WAVE, '"exp(-2*(x**2+y**2))"', '"log(x)"'),
        r"initial\.u: values must be finite; value: nan at \[-4, -4\], and on 153 of 289 nodes in all; "
        "limit: no nan, no inf; remedy: where",
        "41 nan",
    ),
    "a fluid for a solid": (
        case(UNITS + ELASTIC, "young = 1.0", 'of = "water"'),
        r"model\.of: such a model has no speed; value: water; limit: steel, .*; remedy: .* type = \"wave\"",
        "unknown key",
    ),
    "a solid for a fluid": (
        case(UNITS + WAVE, "speed = 1.0", 'of = "steel"'),
        r"model\.of: such a model has no .*young; value: steel; limit: water, air; remedy: one of these, or type",
        "unknown key",
    ),
    "a fluid for a solid, as arguments": (
        lambda: fh.Elastic(fh.Kernel(1.0), **fh.materials.water.constants),
        r"model\.speed: Elastic has no such argument; value: 1482\.3; limit: kernel, young.*; remedy: .*fh\.Wave\(",
        "__init__",
    ),
    "a misspelt argument": (
        lambda: fh.Elastic(fh.Kernel(1.0), youngs=1.0),
        r"model\.youngs: Elastic has no such argument; value: 1; limit: .*; remedy: did you mean 'young'\?",
        "__init__",
    ),
    "a fracture energy of bonds that break by their stretch": (
        lambda: fh.Correspondence(fh.Kernel(1.0), 1.0, 0.3, fracture_energy=1.0),
        r"model\.fracture_energy: Correspondence has no .*; remedy: critical_stretch: bonds break by their stretch",
        "__init__",
    ),
    "the same in a case": (
        case(ELASTIC, 'type = "elastic", young = 1.0', 'type = "correspondence", young = 1.0, fracture_energy = 1.0'),
        r"unknown key model\.fracture_energy; known: type, .*; remedy: critical_stretch: bonds break by their stretch",
        "did you mean",
    ),
    "points outside": (
        lambda: fh.Simulation(PLANE, fh.Wave(fh.Kernel(1.0)), constraints=[fh.Prescribed([(9.0, 0.0)], 1.0)]),
        r"^constraint\.where: the point lies outside the near field; value: \[9, 0\]; limit: ",
        "probes",
    ),
    "displacements held near a layer": (
        lambda: fh.Simulation(
            PLANE,
            fh.Elastic(fh.Kernel(1.0), 1.0),
            constraints=[fh.Prescribed(fh.Box((3.0, -1.0), (9.0, 1.0)), [1e-3, 0.0])],
        ),
        r"constraints: a condition holds on .* x\+, .*; value: \d+ nodes; limit: nodes held at the background, 0, for "
        r"ever, on the last 3 nodes; remedy: keep what moves away from it, or a Free side there",
        "temperature",
    ),
    "no strength in a region": (
        case(
            ELASTIC,
            "young = 1.0",
            "young = 1.0, critical_stretch = 1e-3",
            "[[material]]\nregion = { disc = { radius = 1.0 } }\ncritical_stretch = 0.0\n",
        ),
        r"material\[0\]\.critical_stretch: .* must be positive .*; value: 0; limit: > 0; remedy: a crack where",
        "body",
    ),
    "an impossible ratio in a region": (
        case(
            ELASTIC,
            "young = 1.0",
            'young = 1.0, poisson = 0.3, material = "state-based"',
            "[[material]]\nregion = { disc = { radius = 1.0 } }\npoisson = 0.6\n",
        ),
        r"material\[0\]\.poisson: Poisson's ratio is out of range; value: 0\.6; limit: above -1, below 0\.5",
        "model.poisson",
    ),
    "a region without nodes": (
        case(ELASTIC, more="[[material]]\nregion = { disc = { radius = 1.0, centre = [50.0, 0.0] } }\nyoung = 2.0\n"),
        r"material\[0\]\.region: the region has no node of the near field; .*limit: \[-4, -4\] to \[4, 4\]; remedy",
        "np.float64",
    ),
    "a constant in a region that the model does not have": (
        case(ELASTIC, more="[[material]]\nregion = { disc = { radius = 1.0 } }\nspeed = 2.0\n"),
        r"material\[0\]\.speed: a region has constants that the model has, too",
        "material:",
    ),
    "a side of another material": (
        lambda: fh.Simulation(PLANE, fh.Elastic(fh.Kernel(1.0), 1.0), fh.Higdon()),
        r"limit: Auto, Extended, Fixed, Free, Impedance, LatticePML, Periodic, PlaneWave, Sponge; remedy",
        "Exact",
    ),
    "no density": (
        lambda: fh.Elastic(fh.Kernel(1.0), 1.0, density=0.0),
        r"model\.density: .* value: 0; limit: > 0; remedy: where there is no medium, leave it out of the lattice",
        "a number,",
    ),
    "a fluid": (
        lambda: fh.Elastic(fh.Kernel(1.0), bulk=2.0, shear=0.0, material="state-based"),
        r"model\.shear: .*value: 0; limit: > 0; remedy: a fluid alone is .* type wave; beside a solid",
        "body",
    ),
    "a fluid in a region": (
        case(
            ELASTIC,
            "young = 1.0",
            'bulk = 1.0, shear = 0.5, material = "state-based"',
            "[[material]]\nregion = { disc = { radius = 1.0 } }\nbulk = 1.0\nshear = 0.0\n",
        ),
        r"material\[0\]\.shear: .*value: 0; limit: > 0; remedy: a fluid alone is .* type wave",
        "body",
    ),
    "a plane wave by another name": (
        case(WAVE, more='[[incident]]\ntype = "plane-wave"\ndirection = [1.0, 0.0]\nsignal = "t"\nduration = 1.0\n'),
        r'incident\[0\]\.type: unknown type; value: plane-wave; .*remedy: type = "incident-wave"$',
        'remedy: type = "rayleigh',
    ),
    "a plane wave among the sources": (
        case(WAVE, more='[[source]]\ntype = "plane-wave"\n'),
        r'source\[0\]\.type: unknown type; value: plane-wave; .*remedy: type = "incident-wave" in incident$',
        "boundary",
    ),
    "a plane wave as a table": (
        case(WAVE, more="[plane-wave]\ndirection = [1.0, 0.0]\n"),
        r'unknown key plane-wave; known: .*; remedy: type = "incident-wave" in incident$',
        "did you mean",
    ),
    "a layer by its general name": (
        case(WAVE, more='[boundary]\nall = { type = "pml" }\n'),
        r'boundary\.all\.type: unknown type; value: pml; .*remedy: type = "lattice-pml"',
        'nonlocal-pml"',
    ),
    "a misspelt type": (
        case(WAVE, more='[[incident]]\ntype = "incedent-wave"\n'),
        r'incident\[0\]\.type: unknown type; .*remedy: type = "incident-wave"$',
        "did you mean",
    ),
    "a plane wave onto layers that leave through the sides": (
        lambda: fh.Simulation(
            fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0)),
            fh.Wave(fh.Kernel(1.0), speed="where(x > 1, 1.0, 2.0)"),
            {"all": fh.LatticePML(nodes=8), "y+": fh.Free()},
            sources=[fh.IncidentWave((0.5, 0.8), "exp(-(t-4)**2)", 8.0)],
        ),
        r"incident\.within: .* remedy: no size of the near field helps where another medium leaves .* a layer parallel",
        "enlarge",
    ),
    "a plane wave onto an inclusion near the faces of its box": (
        lambda: fh.Simulation(
            fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0)),
            fh.Wave(fh.Kernel(1.0), speed="where((x-3)**2 + y**2 < 1, 1.0, 2.0)"),
            fh.LatticePML(nodes=8),
            sources=[fh.IncidentWave((1.0, 0.0), "exp(-(t-4)**2)", 8.0)],
        ),
        r"incident\.within: .* remedy: enlarge the near field, or the box if it is given",
        "layer",
    ),
    "no strength": (
        lambda: fh.Elastic(fh.Kernel(1.0), 1.0, critical_stretch=0.0),
        r"model\.critical_stretch: .* value: 0; limit: > 0; remedy: a crack where bonds are cut from the start",
        "body",
    ),
    "an expansion that is nan": (
        lambda: fh.ThermalLoad("x", expansion=np.nan, reference=0.0),
        r"load\.expansion: must be finite; value: nan; limit: no nan, no inf; remedy: see where it comes from",
        "value: none",
    ),
    "a pressure that is not symmetric": (
        lambda: fh.Pressure(fh.Disc(1.0, (0.0, 0.0)), [[1.0, 2.0], [0.0, 1.0]]),
        r"load\.value: .* symmetric; value: \[\[1, 2\], \[0, 1\]\]; limit: P = P\^T; remedy: \[\[1, 1\], \[1, 1\]\]",
        "np.",
    ),
    "heat without a reference": (
        case(ELASTIC, more='[[load]]\ntype = "thermal"\ntemperature = "10*exp(-x**2)"\nexpansion = 1e-5\n'),
        r"missing key load\[0\]\.reference: temperature at which the solid is free of stress$",
        "None",
    ),
}
BEST = {
    "a horizon below the spacing": (
        case(WAVE, "horizon = 1.0", "horizon = 0.2"),
        r"kernel\.horizon: the horizon is smaller than the spacing, no node has neighbours; value: 0\.2; "
        r"limit: >= 0\.5; remedy: horizon = 1\.5 \(three spacings\) or a finer lattice",
    ),
    "no whole number of spacings": (
        case(WAVE, "upper = [4.0, 4.0]", "upper = [4.1, 4.0]"),
        r"lattice\.upper: upper - lower is not a whole number of spacings; .*remedy: nearest upper = \[4, 4\]",
    ),
    "the other power": (
        case(WAVE, "x**2+", "x^2+"),
        r"initial\.u: the operator \^ is not allowed in an expression; .*remedy: write a power as \*\*",
    ),
    "memory": (
        case(WAVE, "lower = [-4.0, -4.0], upper = [4.0, 4.0]", "lower = [-9e6, -9e6], upper = [9e6, 9e6]"),
        "lattice: the run does not fit into memory; value: about .* GiB for 1296000072000001 nodes; "
        "limit: .* GiB available; remedy: a coarser or smaller lattice, thinner layers, or float32",
    ),
    "data beyond a side": (
        case(WAVE, "exp(-2*(", "exp(-0.05*("),
        r"initial\.u: not zero beyond the absorbing side x-; .*an error of about 0\.36 of the largest initial value; "
        ".*set background to its value far away",
    ),
    "several mistakes in one go": (
        case(WAVE, "horizon", "horizn"),
        r"unknown key model\.kernel\.horizn; did you mean 'horizon'\?.* \| missing key model\.kernel\.horizon",
    ),
}


@pytest.mark.parametrize("name", WORST)
def test_the_worst_messages_are_rewritten(name):
    wrong, said, before = WORST[name]
    with pytest.raises(fh.InputError, match=said) as error:
        wrong()
    assert before not in str(error.value)


@pytest.mark.parametrize("name", BEST)
def test_the_best_messages_stay(name):
    wrong, said = BEST[name]
    with pytest.raises(fh.InputError, match=said):
        wrong()


def test_what_grows_without_layers_is_not_put_down_to_layers():
    from farhorizon.simulation.time.outer_loop import likely_cause

    sim = fh.Simulation(fh.Lattice(0.5, -4, 4), fh.Wave(fh.Kernel(1.0, 0)), fh.Fixed())
    assert "layer" not in likely_cause(sim)
