"""Messages of what is refused of sources and recorders: key, value, limit and remedy."""

import pytest

import farhorizon as fh

_LATTICE, _WAVE = fh.Lattice(0.5, (-10.0, -10.0), (10.0, 10.0)), fh.Wave(fh.Kernel(1.0))
_CASE = """
[lattice]
spacing = 0.5
lower = [-10.0, -10.0]
upper = [10.0, 10.0]
[model]
type = "wave"
kernel = { horizon = 1.0 }
[run]
until = 1.0
"""


def _made(*observe, sources=()):
    return fh.Simulation(_LATTICE, _WAVE, fh.LatticePML(nodes=8), observe=observe, sources=sources)


@pytest.mark.parametrize(
    ("given", "key", "words"),
    [
        ({"sources": [fh.PointSource((0.0, 0.0), time="cos(t)")]}, "source.time", "begin at rest"),
        ({"sources": [fh.PointSource((0.0, 0.0), time=lambda t: 1.0 + t)]}, "source.time", "begin at rest"),
        ({"observe": [fh.PowerThrough(("x", 50.0))]}, "power.surfaces", "plane lies outside"),
        ({"observe": [fh.PowerThrough(fh.Disc(3.0, (50.0, 0.0)))]}, "power.surfaces", "no node of the near field"),
        (
            {"observe": [fh.Receivers([(0.0, 0.0)]), fh.Receivers([(11.0, 0.0)], name="b")]},
            "receivers[1].points",
            "outside",
        ),
        (
            {"observe": [fh.Spectra([(0.0, 0.0)], [9.0]), fh.Spectra([(1.0, 0.0)], [0.1], name="b")]},
            "spectra[0].frequencies",
            "above Nyquist's",
        ),
    ],
)
def test_refused_with_key_value_limit_and_remedy(given, key, words):
    with pytest.raises(fh.InputError, match=words) as error:
        _made(*given.get("observe", ()), sources=given.get("sources", ()))
    found = error.value
    assert found.key == key
    assert found.value is not None and found.limit is not None and found.remedy


def test_a_load_that_acts_from_the_start_on_is_none_that_jumps():
    _made(sources=[fh.PointSource((0.0, 0.0), time=2.0), fh.PointSource((0.0, 1.0), time="sin(t)")])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[source]]\ntype = "point-source"\nat = [0.0, 0.0]\ntime = "cos(t)"\n', r"source.*time: .*begin at rest"),
        (
            "[[receivers]]\npoints = [[0.0, 0.0]]\n[[receivers]]\npoints = [[11.0, 0.0]]\n",
            r"receivers\[1\]\.points: .*outside the near field",
        ),
    ],
)
def test_case_files_name_the_same(tmp_path, text, words):
    path = tmp_path / "a.toml"
    path.write_text(_CASE + text)
    with pytest.raises(fh.InputError, match=rf"{words}.*value: .*limit: .*remedy: "):
        fh.read_case(path).run()
