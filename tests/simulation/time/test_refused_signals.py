"""Refused sources and recorders: each message has a key, a value, a limit and a remedy, from Python and from a case."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

_PLANE, _HALF = ((-10.0, -10.0), (10.0, 10.0)), ((-12.0, -12.0), (12.0, 0.0))
_KERNEL, _LAYER = fh.Kernel(1.0), fh.LatticePML(nodes=8)
_WAVE, _ELASTIC = fh.Wave(_KERNEL), fh.Elastic(_KERNEL, young=1.0)
_HOLE = fh.Box(*_PLANE) - fh.Disc(3.0, (5.0, 5.0))
_CRACK = [[(0.1, -2.0), (0.1, 2.0)]]
_SPACE = """
boundary = { all = { type = "lattice-pml", nodes = 8 } }
run = { until = 1.0 }
"""
_KINDS = {kind: f'model = {{ type = "{kind}", kernel = {{ horizon = 1.0 }} }}\n' for kind in ("wave", "diffusion")}
_KINDS["elastic"] = 'model = { type = "elastic", kernel = { horizon = 1.0 }, young = 1.0 }\n'
_LATTICE = "[lattice]\nspacing = 0.5\nlower = [-10.0, -10.0]\nupper = [10.0, 10.0]\n"
_BODY = """[lattice.body]
box = { lower = [-10.0, -10.0], upper = [10.0, 10.0] }
without = [{ disc = { radius = 3.0, centre = [5.0, 5.0] } }]
"""


class _Base(NamedTuple):
    """A set-up in both forms: arguments of `Simulation`, and its case file."""

    given: dict[str, object]
    text: str


def _base(model=_WAVE, kind="wave", body=None, more="", **given):
    lattice = fh.Lattice(0.5, *_PLANE, body=body)
    return _Base(
        {"lattice": lattice, "model": model, "boundary": _LAYER, **given}, _SPACE + _KINDS[kind] + _LATTICE + more
    )


_BASES = {
    "wave": _base(),
    "elastic": _base(_ELASTIC, "elastic"),
    "diffusion": _base(fh.Diffusion(_KERNEL), "diffusion"),
    "hole": _base(body=_HOLE, more=_BODY),
    "elastic hole": _base(_ELASTIC, "elastic", _HOLE, _BODY),
    "crack": _base(cracks=_CRACK, more="[[crack]]\npoints = [[0.1, -2.0], [0.1, 2.0]]\n"),
    "half": _Base(
        {
            "lattice": fh.Lattice(1.0, *_HALF),
            "model": fh.Elastic(fh.Kernel(2.0), young=1.0),
            "boundary": {"all": _LAYER, "y+": fh.Free()},
        },
        """
lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 0.0] }
model = { type = "elastic", kernel = { horizon = 2.0 }, young = 1.0 }
boundary = { all = { type = "lattice-pml", nodes = 8 }, "y+" = { type = "free" } }
run = { until = 1.0 }
""",
    ),
    "bar": _Base(
        {"lattice": fh.Lattice(0.5, -20.0, 20.0), "model": _ELASTIC},
        "lattice = { spacing = 0.5, lower = [-20.0], upper = [20.0] }\nrun = { until = 1.0 }\n" + _KINDS["elastic"],
    ),
}
_PULSE = "sin(t)*exp(-(t-9)**2)"


def _all(given):
    return {"observe": given}


def _source(make):
    return lambda: {"sources": [make()]}


def _observed(make):
    return lambda: {"observe": [make()]}


def _receivers(points, **options):
    return _observed(lambda: fh.Receivers(points, **options))


def _far(lower, upper, **options):
    return _observed(lambda: fh.FarField(fh.Box(lower, upper), **options))


def _point(at, time=1.0, **options):
    return _source(lambda: fh.PointSource(at, time=time, **options))


def _wave(signal=_PULSE, within=None):
    return _source(lambda: fh.IncidentWave((1.0, 0.0), signal, duration=20.0, within=within))


def _receivers_table(points, more=""):
    return f"[[receivers]]\npoints = {points}\n{more}"


def _source_table(kind, lines):
    return f'[[source]]\ntype = "{kind}"\n{lines}'


def _wave_table(signal=_PULSE, within=""):
    box = f"within = {{ {within} }}\n" if within else ""
    return f'[[incident]]\ndirection = [1.0, 0.0]\nsignal = "{signal}"\nduration = 20.0\n{box}'


def _far_table(lower, upper, more=""):
    return f"[far_field]\nbox = {{ lower = {lower}, upper = {upper} }}\n{more}"


def _samples_table(values, dt=0.1):
    return _source_table("point-source", f'at = [0, 0]\ntime = {{ type = "samples", values = {values}, dt = {dt} }}\n')


def _samples(values, dt=0.1):
    return _source(lambda: fh.PointSource((0.0, 0.0), time=fh.Samples(values, dt)))


_AT, _OUT, _IN_HOLE, _BY_HOLE, _BY_EDGE = (
    "[[0.0, 0.0]]",
    "[[11.0, 0.0]]",
    "[[5.0, 5.0]]",
    "[[5.1, 1.1]]",
    "[[9.3, 0.1]]",
)
_TWICE = "[[receivers]]\npoints = [[0.0, 0.0]]\nname = 'a'\n[[receivers]]\npoints = [[0.0, 1.0]]\nname = 'a'\n"
_ARRAY = "first = [-4.0, 0.0]\nlast = [4.0, 0.0]\nelements = 4\nstrength = 1.0\nspeed = 1.0\nangle = 10.0\n"
_NAN = "must be (a )?finite"
_PARTS = "value: .+; limit: .+; remedy: .+"
_REST = "does not begin at rest"
_BAND = "the lattice does not carry"

# (set-up, what is wrong in Python, what is wrong in a case file, words of the message)
_REFUSED: dict[str, tuple[str, Callable[[], dict[str, object]], str, str]] = {
    # receivers
    "receiver outside": ("wave", _receivers([(11.0, 0.0)]), _receivers_table(_OUT), "outside the near field"),
    "receiver in a hole": ("hole", _receivers([(5.0, 5.0)]), _receivers_table(_IN_HOLE), "has no node"),
    "receiver by a hole": ("hole", _receivers([(5.1, 1.1)]), _receivers_table(_BY_HOLE), "so close to the edge"),
    "receiver by the edge": ("wave", _receivers([(9.3, 0.1)]), _receivers_table(_BY_EDGE), "so close to the edge"),
    "gradient by the edge": (
        "wave",
        _receivers([(9.0, 0.0)], record=["gradient"]),
        _receivers_table("[[9.0, 0.0]]", 'record = ["gradient"]\n'),
        "so close to the edge(?=.*because derivatives use neighbours)",
    ),
    "receiver by a crack": (
        "crack",
        _receivers([(0.3, 0.1)]),
        _receivers_table("[[0.3, 0.1]]"),
        "a crack lies between",
    ),
    "receiver in 3D": ("wave", _receivers([(0.0, 0.1, 2.0)]), _receivers_table("[[0.0, 0.1, 2.0]]"), "another shape"),
    "receiver nowhere": ("wave", _receivers([(np.nan, 0.1)]), _receivers_table("[[nan, 0.1]]"), _NAN),
    "no receiver": ("wave", _receivers(np.zeros((0, 2))), _receivers_table("[]"), "no point|another shape"),
    "a line in 1D and 2D": (
        "wave",
        _observed(lambda: fh.Receivers.line((0.0,), (1.0, 1.0), 3)),
        "[[receivers]]\nline = { start = [0.0], end = [1.0, 1.0], count = 3 }\n",
        "both ends of a line",
    ),
    "unknown quantity": (
        "wave",
        _receivers([(0.0, 0.0)], record="w"),
        _receivers_table(_AT, 'record = ["w"]\n'),
        "unknown quantity",
    ),
    "no quantity": ("wave", _receivers([(0.0, 0.0)], record=[]), _receivers_table(_AT, "record = []\n"), "nothing"),
    "stress of a scalar": (
        "wave",
        _receivers([(0.0, 0.0)], record="stress"),
        _receivers_table(_AT, 'record = ["stress"]\n'),
        "has no such quantity",
    ),
    "velocity of diffusion": (
        "diffusion",
        _receivers([(0.0, 0.0)], record="v"),
        _receivers_table(_AT, 'record = ["v"]\n'),
        "has no such quantity",
    ),
    "every 0th step": ("wave", _receivers([(0.0, 0.0)], every=0), _receivers_table(_AT, "every = 0\n"), "out of range"),
    "a name with a slash": (
        "wave",
        _receivers([(0.0, 0.0)], name="a/b"),
        _receivers_table(_AT, 'name = "a/b"\n'),
        "a name has letters",
    ),
    "two of one name": (
        "wave",
        lambda: _all([fh.Receivers([(0.0, y)], name="a") for y in (0.0, 1.0)]),
        _TWICE,
        "two recorders have one name",
    ),
    # sources
    "source outside": (
        "wave",
        _point((20.0, 0.0)),
        _source_table("point-source", "at = [20.0, 0.0]\n"),
        "outside the near field",
    ),
    "source in a hole": ("hole", _point((5.0, 5.0)), _source_table("point-source", "at = [5, 5]\n"), "has no node"),
    "source by the edge": (
        "wave",
        _point((9.3, 0.0)),
        _source_table("point-source", "at = [9.3, 0.0]\n"),
        "so close to the edge",
    ),
    "force in a hole": (
        "elastic hole",
        _source(lambda: fh.PointForce((5.0, 5.0), (1.0, 0.0))),
        _source_table("point-force", "at = [5, 5]\nforce = [1, 0]\n"),
        "has no node",
    ),
    "moment in a hole": (
        "elastic hole",
        _source(lambda: fh.MomentTensor((5.0, 5.0), 1.0)),
        _source_table("moment-tensor", "at = [5, 5]\nmoment = 1.0\n"),
        "has no node",
    ),
    "line through a hole": (
        "hole",
        _source(lambda: fh.LineSource([(0.0, 5.0), (5.0, 5.0)], 1.0)),
        _source_table("line-source", "points = [[0, 5], [5, 5]]\nstrength = 1\n"),
        "has no node",
    ),
    "array outside": (
        "wave",
        _source(lambda: fh.PhasedArray((-12.0, 0.0), (4.0, 0.0), 4, 1.0, fh.Ricker(0.1))),
        _source_table(
            "phased-array",
            "first = [-12, 0]\nlast = [4, 0]\nelements = 4\nstrength = 1\n"
            'time = { type = "ricker", frequency = 0.1 }\n',
        ),
        "outside the near field",
    ),
    "force on a scalar": (
        "wave",
        _source(lambda: fh.PointForce((0.0, 0.0), (1.0, 0.0))),
        _source_table("point-force", "at = [0, 0]\nforce = [1, 0]\n"),
        "one of another field",
    ),
    "scalar source of a solid": (
        "elastic",
        _point((0.0, 0.0)),
        _source_table("point-source", "at = [0, 0]\n"),
        "one of another field",
    ),
    "moment of a scalar": (
        "wave",
        _source(lambda: fh.MomentTensor((0.0, 0.0), 1.0)),
        _source_table("moment-tensor", "at = [0, 0]\nmoment = 1\n"),
        "acts on an elastic medium",
    ),
    "double couple in 2D": (
        "elastic",
        _source(lambda: fh.MomentTensor((0.0, 0.0), 1.0, strike=0, dip=90, rake=0)),
        _source_table("moment-tensor", "at = [0, 0]\nmoment = 1\nstrike = 0\ndip = 90\nrake = 0\n"),
        "another number of dimensions",
    ),
    "moment with a torque": (
        "elastic",
        _source(lambda: fh.MomentTensor((0.0, 0.0), [[1, 2], [3, 4]])),
        _source_table("moment-tensor", "at = [0, 0]\nmoment = [[1, 2], [3, 4]]\n"),
        "is symmetric",
    ),
    # signals
    "cosine at a point": (
        "wave",
        _point((0.0, 0.0), "cos(t)"),
        _source_table("point-source", 'at = [0, 0]\ntime = "cos(t)"\n'),
        _REST,
    ),
    "cosine of a force": (
        "elastic",
        _source(lambda: fh.PointForce((0.0, 0.0), (1.0, 0.0), "cos(t)")),
        _source_table("point-force", 'at = [0, 0]\nforce = [1, 0]\ntime = "cos(t)"\n'),
        _REST,
    ),
    "cosine of an array": (
        "wave",
        _source(lambda: fh.PhasedArray((-4.0, 0.0), (4.0, 0.0), 4, 1.0, "cos(t)", speed=1.0, angle=10.0)),
        _source_table("phased-array", _ARRAY + 'time = "cos(t)"\n'),
        _REST,
    ),
    "early Ricker": (
        "wave",
        _source(lambda: fh.PointSource((0.0, 0.0), time=fh.Ricker(1.0, delay=0.1))),
        _source_table("point-source", 'at = [0, 0]\ntime = { type = "ricker", frequency = 1.0, delay = 0.1 }\n'),
        _REST,
    ),
    "early Gaussian": (
        "wave",
        _source(lambda: fh.PointSource((0.0, 0.0), time=fh.Gaussian(1.0, delay=0.1))),
        _source_table("point-source", 'at = [0, 0]\ntime = { type = "gaussian", width = 1.0, delay = 0.1 }\n'),
        _REST,
    ),
    "samples that jump": ("wave", _samples([1.0, 2, 3, 4, 0]), _samples_table("[1.0, 2, 3, 4, 0]"), _REST),
    "two samples": ("wave", _samples([0.0, 2.0]), _samples_table("[0.0, 2.0]"), "one list of samples"),
    "silent samples": ("wave", _samples([0.0] * 6), _samples_table([0.0] * 6), "all samples are zero"),
    "a gap in samples": ("wave", _samples([0.0, np.nan, 1, 2, 0]), _samples_table("[0.0, nan, 1, 2, 0]"), _NAN),
    "no file of samples": ("wave", _samples("nofile.txt"), _samples_table('"nofile.txt"'), "cannot read the samples"),
    "samples of another unit": (
        "wave",
        _samples([0.0, 1, 0, -1, 0, 0], 1e-6),
        _samples_table("[0.0, 1, 0, -1, 0, 0]", 1e-6),
        _BAND,
    ),
    "a Ricker too high": (
        "wave",
        _point((0.0, 0.0), fh.Ricker(1e6)),
        _source_table("point-source", 'at = [0, 0]\ntime = { type = "ricker", frequency = 1e6 }\n'),
        _BAND,
    ),
    # incident waves
    "cosine from afar": ("crack", _wave("cos(t/3)"), _wave_table("cos(t/3)"), _BAND),
    "cosine along a surface": (
        "half",
        _source(lambda: fh.RayleighWave((1.0, 0.0), "cos(t/3)", duration=40.0)),
        '[[incident]]\ntype = "rayleigh-wave"\ndirection = [1, 0]\nsignal = "cos(t/3)"\nduration = 40\n',
        _BAND,
    ),
    "wave's box by a crack": (
        "crack",
        _wave(within=fh.Box((-5.0, -1.0), (5.0, 1.0))),
        _wave_table(within="lower = [-5, -1], upper = [5, 1]"),
        "is too small",
    ),
    "wave's box in a layer": (
        "crack",
        _wave(within=fh.Box(*_PLANE)),
        _wave_table(within="lower = [-10, -10], upper = [10, 10]"),
        "reaches too far",
    ),
    "wave's box through a hole": (
        "hole",
        _wave(within=fh.Box((-6.0, -6.0), (6.0, 6.0))),
        _wave_table(within="lower = [-6, -6], upper = [6, 6]"),
        "not uniform near the faces",
    ),
    # the far field
    "far box through a crack": ("crack", _far((-5, -5), (0, 5)), _far_table([-5, -5], [0, 5]), "cuts a crack"),
    "far box at a layer": ("wave", _far(*_PLANE), _far_table([-10, -10], [10, 10]), "must leave one reach"),
    "far box in a layer": ("wave", _far((-12, -9), (9, 9)), _far_table([-12, -9], [9, 9]), "must leave one reach"),
    "far box through a hole": ("hole", _far((-5, -5), (5, 5)), _far_table([-5, -5], [5, 5]), "cuts a hole"),
    "far box turned over": ("wave", _far((5, 5), (-5, -5)), _far_table([5, 5], [-5, -5]), "must be greater"),
    "far box of nothing": ("wave", _far((-0.5,) * 2, (0.5,) * 2), _far_table([-0.5] * 2, [0.5] * 2), "so small"),
    "far receiver inside": (
        "wave",
        _far((-5, -5), (5, 5), points=[(0.0, 0.0)]),
        _far_table([-5, -5], [5, 5], "points = [[0.0, 0.0]]\n"),
        "lies inside the box",
    ),
    # frequencies
    **{
        f"far frequency {f}": (
            "wave",
            _observed(lambda f=f: fh.FarField(frequencies=[f])),
            f"[far_field]\nfrequencies = [{f}]\n",
            _NAN if np.isnan(f) else _BAND,
        )
        for f in (50.0, 1.0, 0.0, -1.0, np.nan)
    },
    **{
        f"{name} {frequency}": ("wave", _observed(make), f"[[{table}]]\n{lines}frequencies = [{frequency}]\n", words)
        for frequency, words in ((50.0, "above Nyquist's"), (1.5, "no wave on the lattice"))
        for name, table, lines, make in (
            ("spectra", "spectra", "points = [[0.0, 0.0]]\n", lambda f=frequency: fh.Spectra([(0.0, 0.0)], [f])),
            (
                "power",
                "power",
                "region = { disc = { radius = 3.0 } }\n",
                lambda f=frequency: fh.PowerThrough(fh.Disc(3.0), [f]),
            ),
        )
    },
    "no frequency": (
        "wave",
        _observed(lambda: fh.Spectra([(0.0, 0.0)], [])),
        "[[spectra]]\npoints = [[0.0, 0.0]]\nfrequencies = []\n",
        "one or more numbers",
    ),
    "spectra of no node": (
        "wave",
        _observed(lambda: fh.Spectra(fh.Disc(1.0, (50.0, 0.0)), [0.1])),
        "[[spectra]]\nregion = { disc = { radius = 1.0, centre = [50.0, 0.0] } }\nfrequencies = [0.1]\n",
        "no node of the near field",
    ),
    # power and shells
    "power of a plane outside": (
        "wave",
        _observed(lambda: fh.PowerThrough(("x", 50.0))),
        '[[power]]\naxis = "x"\nposition = 50.0\n',
        "plane lies outside",
    ),
    "power of a region outside": (
        "wave",
        _observed(lambda: fh.PowerThrough(fh.Disc(3.0, (50.0, 0.0)))),
        "[[power]]\nregion = { disc = { radius = 3.0, centre = [50.0, 0.0] } }\n",
        "no node of the near field",
    ),
    "power along no axis": (
        "wave",
        _observed(lambda: fh.PowerThrough(("q", 5.0))),
        '[[power]]\naxis = "q"\nposition = 5.0\n',
        "no such axis",
    ),
    "power through nothing": ("wave", _observed(lambda: fh.PowerThrough([])), "[[power]]\n", "no surface|give either"),
    "shell in a layer": (
        "wave",
        _observed(lambda: fh.ShellRecorder(fh.Box(*_PLANE))),
        "[[shell]]\nbox = { lower = [-10, -10], upper = [10, 10] }\n",
        "reaches too far",
    ),
    "elastic line": (
        "bar",
        _receivers([0.3], record="curl"),
        '[[receivers]]\npoints = [[0.3]]\nrecord = ["curl"]\n',
        "two or three dimensions",
    ),
}


def _is_whole(error):
    assert error.key and error.value is not None and error.limit is not None and error.remedy, str(error)
    return True


@pytest.mark.parametrize("name", _REFUSED)
def test_refused_with_key_value_limit_and_remedy(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    base, made, text, words = _REFUSED[name]
    with pytest.raises(fh.InputError, match=words) as error:
        fh.Simulation(**_BASES[base].given, **made())
    assert _is_whole(error.value)
    with pytest.raises(fh.InputError, match=rf"(?:{words}).*{_PARTS}"):
        Case(_BASES[base].text + text).run()


@pytest.mark.parametrize("given", ["a", ["a"], fh.Receivers([(0.0, 0.0)])])
def test_what_observes_is_a_list_of_recorders_and_functions(given):
    with pytest.raises(fh.InputError) as error:
        fh.Simulation(**_BASES["wave"].given, observe=given)
    assert error.value.key == "observe" and _is_whole(error.value)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ("0 0\n1 1\n2 0\n", "one list of samples"),  # fewer than a spline needs
        ("0 0\n1e-6 1\n2e-6 0\n3e-6 -1\n4e-6 0\n", "times in the file"),  # microseconds
        ("5 0\n6 1\n7 0\n8 -1\n9 0\n", "times in the file"),  # begins later
        ("0\n1\nx\n", "cannot read the samples"),
    ],
)
def test_a_file_of_samples_of_another_length_or_unit(tmp_path, times, words):
    path = tmp_path / "signal.txt"
    path.write_text(times)
    with pytest.raises(fh.InputError, match=words) as error:
        fh.Samples(path, 1.0)
    assert _is_whole(error.value)
    with pytest.raises(fh.InputError, match=rf"source\.time\.\w+: .*{words}.*{_PARTS}"):
        Case(_BASES["wave"].text + _samples_table(f'"{path.as_posix()}"', 1.0)).run()


def test_which_of_several_recorders_is_meant():
    observe = [fh.Receivers([(0.0, 0.0)]), fh.Receivers([(11.0, 0.0)], name="b")]
    with pytest.raises(fh.InputError, match=r"receivers\[1\]\.points: .*outside"):
        fh.Simulation(**_BASES["wave"].given, observe=observe)
    text = _receivers_table(_AT) + _receivers_table(_OUT)
    with pytest.raises(fh.InputError, match=r"receivers\[1\]\.points: .*outside"):
        Case(_BASES["wave"].text + text).run()


@pytest.mark.parametrize(
    "time",
    [
        2.0,
        "where(t < 2, 1, 0)",
        "where(t < 2, 3, where(t < 5, -1, 0))",
        "sin(t)",
        "exp(-(t - 90)**2/400)",  # grows by more than a thousandth over the first steps, but they are all small
        lambda t: 1.0 if t < 1.0 else 0.0,
    ],
)
def test_what_may_act_at_a_point_from_the_start_on(time):
    """The jump of a load that is applied and held is intended; a load that is small at first is accepted, too."""
    sim = fh.Simulation(**_BASES["wave"].given, sources=[fh.PointSource((0.0, 0.0), time=time)])
    assert not [note for note in sim.notes if "jump" in note]


@pytest.mark.parametrize(
    ("source", "jumps"),
    [
        (fh.Source("exp(-x**2 - y**2)", "cos(t)"), True),
        (fh.Source("exp(-x**2 - y**2)*cos(t)"), True),
        (fh.Source("exp(-x**2 - y**2)*cos(x + t)"), True),
        (fh.Source(lambda x, y, t: np.exp(-(x**2) - y**2) * np.cos(t)), True),
        (fh.Source("exp(-x**2 - y**2)", lambda t: [1.0, 0.9, 0.8, 0.7, 0.6][int(2 * t)]), True),  # undefined later
        (fh.Source("exp(-x**2 - y**2)", "sin(t)"), False),
        (fh.Source("exp(-x**2 - y**2)*sin(x*t)"), False),
        (fh.Source("exp(-x**2 - y**2)"), False),
        (fh.Source("exp(-x**2 - y**2)*where(t < 3, 1, 0)"), False),
        (fh.Source("exp(-x**2 - y**2)", fh.Ricker(0.1)), False),
    ],
)
def test_a_shape_that_begins_with_a_jump_is_told(source, jumps):
    """It is not refused, since its waves are no shorter than the shape."""
    sim = fh.Simulation(**_BASES["wave"].given, sources=[source])
    assert bool([note for note in sim.notes if "begins with a jump" in note]) == jumps


def test_a_load_that_begins_with_a_jump_is_told():
    load = fh.BodyForce(["exp(-x**2 - y**2)", 0.0], time="cos(t)")
    sim = fh.Simulation(**_BASES["elastic"].given, loads=[load])
    assert any(note.startswith("load[0] begins with a jump") for note in sim.notes)
