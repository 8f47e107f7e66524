"""Views of a results file: times, ranges and slices that exist."""

import numpy as np
import pytest

from drawn import axes_of
from farhorizon.errors import InputError
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.pictures.views import View


def results(path, dim=2):
    shape = tuple(len(axis) for axis in axes_of(dim, 9))
    writer = ResultsWriter.create(path, shape=shape, spacing=0.25, lower=(-1.0,) * dim, fields=("u",), dtype="float64")
    for k in range(4):
        writer.append(k, 0.5 * k, {"u": np.zeros(shape)})
    return open_results(path)


def test_the_nearest_time_is_said(tmp_path):
    said = []
    assert View(times=[0.5, 0.6, 99.0]).chosen(results(tmp_path / "a.h5"), said.append) == [1, 3]
    assert said == [
        "t = 0.6 is not stored; t = 0.5, the nearest, is drawn",
        "t = 99 is not stored; t = 1.5, the nearest, is drawn",
    ]


@pytest.mark.parametrize("limits", [(1.0, 1.0), (2.0, 1.0), (np.nan, 1.0), (0.0, np.inf)])
def test_an_empty_range_is_refused(limits):
    with pytest.raises(InputError, match="--range: a range goes from a number to a larger one"):
        View(limits=limits)


@pytest.mark.parametrize("asked", [{"deformed": 0.0, "movie": True}, {"isosurfaces": [], "movie": True}])
def test_one_kind_of_picture_is_drawn_at_a_time(asked):
    """The film was once omitted silently."""
    with pytest.raises(InputError, match="--movie; remedy: plot once for each"):
        View(**asked)


@pytest.mark.parametrize("other", [{"fields": ["u_curl"]}, {"limits": (-1.0, 1.0)}, {"decibels": True}])
def test_a_deformed_shape_has_colours_of_its_own(other):
    with pytest.raises(InputError, match="colours of a deformed shape"):
        View(deformed=0.0, **other)


def test_only_space_is_sliced(tmp_path):
    with pytest.raises(InputError, match="--slice: only a 3D lattice"):
        View(planes=[("x", 0.0)]).slices(results(tmp_path / "a.h5"))


def test_names_of_slices_tell_where_they_are_and_what_else_is_asked_for(tmp_path):
    file = results(tmp_path / "a.h5", 3)
    (one,) = View(planes=[("z", 0.5)], suffix="-t=1").slices(file)
    assert one.suffix == "-z=0.5-t=1" and one.plane == (2, 6)
    assert [one.suffix for one in View(suffix="-dB").slices(file)] == ["-dB"]
