"""What notebooks show of runs, models and reports: figures, films, tables and xarray data."""

import builtins
from html.parser import HTMLParser

import numpy as np
import pytest

import farhorizon as fh


def wave(**options):
    lattice, model = fh.Lattice(0.5, (-4, -4), (4, 4)), fh.Wave(fh.Kernel(1.0), speed=2.0)
    return fh.Simulation(lattice, model, fh.LatticePML(nodes=6), {"u": "exp(-x**2-y**2)"}, **options)


def solid(dim):
    model = fh.Elastic(fh.Kernel(1.0), young=1.0)
    start = {"u": ["exp(-x**2)", *["0"] * (dim - 1)]}
    return fh.Simulation(fh.Lattice(0.5, [-3] * dim, [3] * dim), model, fh.Fixed(), start)


class Cells(HTMLParser):
    """Parser that collects the texts of the cells of a table."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.found.append(data)


def test_a_run_draws_itself(tmp_path):
    """The image is the field, in axes of its own; notebooks get a PNG."""
    sim = wave()
    sim.step(7)
    figure = sim.plot("u", tmp_path / "u.pdf")
    (image,) = figure.axes[0].images
    np.testing.assert_array_equal(image.get_array(), sim.fields["u"].T)
    assert figure._repr_png_().startswith(b"\x89PNG") and (tmp_path / "u.pdf").read_bytes().startswith(b"%PDF")
    assert figure.axes[0].get_title() == f"t = {sim.time:.4g}"
    assert sim.plot("u", limits=(-1, 1)).axes[0].images[0].get_clim() == (-1, 1)
    with pytest.raises(fh.InputError, match="name: there is no such field; value: w; limit: u, v"):
        sim.plot("w")
    with pytest.raises(fh.InputError, match=r"path: unknown format; value: u.jpg; limit: png, pdf, svg"):
        sim.plot("u", tmp_path / "u.jpg")
    with pytest.raises(fh.InputError, match="limits: a range goes from"):
        sim.plot("u", limits=(1.0, -1.0))


def test_a_run_draws_a_film_as_it_goes_on(tmp_path):
    from PIL import Image

    sim, seen = wave(dt=fh.WholeSteps(every=0.1)), []
    sim.observers.append(lambda run: seen.append(run.time))
    film = sim.animate(until=0.5, every=0.1, path=tmp_path / "u.gif")
    assert sim.time == pytest.approx(0.5) and len(seen) == 5 and len(sim.observers) == 1
    with Image.open(tmp_path / "u.gif") as found:
        assert found.n_frames == film.frames == 6
    assert (tmp_path / "u.gif").read_bytes() == film.data and "data:image/gif;base64," in film._repr_html_()
    film.save(tmp_path / "copy.gif")
    assert (tmp_path / "copy.gif").read_bytes() == film.data and "6 frames, gif" in repr(film)
    for wrong, message in (
        ({"name": "w", "until": 1.0}, "name: there is no such field; .*limit: u, v"),
        ({"until": 0.5}, "run.until: the film ends before it begins; value: 0.5; limit: > 0.5"),
        ({"until": 1.0, "path": tmp_path / "u.avi"}, "path: unknown format of films; value: u.avi; limit: gif, mp4"),
        ({"until": 1.0, "path": tmp_path / "no" / "u.gif"}, "path: .*there is no directory"),
        ({"until": 1.0, "limits": (1, 1)}, "limits: a range goes from"),
    ):
        with pytest.raises(fh.InputError, match=message):
            sim.animate(**{"every": 0.1, **wrong})
    assert sim.time == pytest.approx(0.5)


def test_a_film_in_space_is_of_the_slice_in_the_middle():
    from farhorizon.pictures.snapshot import Frames

    axes = [np.linspace(-1, 1, n) for n in (4, 5, 7)]
    frames, values = Frames("u", axes), np.random.default_rng(0).random((4, 5, 7))
    for number in range(2):
        frames.add({"u": values + number}, str(number))
    assert np.array_equal(frames._frames[1][1][:, :, 0], values[:, :, 3] + 1) and frames.film().frames == 2


@pytest.mark.parametrize("dim", [2, 3])
def test_vectors_are_drawn_by_length_and_component(dim):
    sim = solid(dim)
    sim.step(3)
    u = sim.fields["u"]
    for name, values in (("u", np.sqrt((u**2).sum(0))), ("u_x", u[0])):
        (image,) = sim.plot(name).axes[0].images
        expected = values if dim == 2 else values[:, :, values.shape[2] // 2]
        np.testing.assert_allclose(image.get_array(), expected.T, atol=1e-15)
    with pytest.raises(fh.InputError, match="limit: u, u_x, u_y"):
        sim.plot("u_w")


def test_fields_as_xarray(monkeypatch):
    pytest.importorskip("xarray")
    sim = solid(2)
    sim.step(3)
    found = sim.to_xarray()
    np.testing.assert_array_equal(found["u"].sel(component="y").values, sim.fields["u"][1])
    assert found["u"].dims == ("component", "x", "y") and float(found["time"]) == sim.time
    np.testing.assert_array_equal(found["x"].values, sim.lattice.axes[0])
    assert wave().to_xarray()["u"].dims == ("x", "y")
    real = builtins.__import__

    def missing(name, *given, **named):
        if name == "xarray":
            raise ImportError(name)
        return real(name, *given, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(fh.InputError, match=r"xarray is not installed; remedy: pip install 'farhorizon\[xarray\]'"):
        sim.to_xarray()


def test_notebooks_show_tables():
    sim = wave(sources=["exp(-2*(x**2+y**2))*where(x < 1, 1, 0)*sin(t)"])
    report = sim.check(5.0, 0.1)
    for shown, words in (
        (sim, ["Simulation on 17 x 17 nodes at t = 0, step 0", "lattice", "model", "boundary"]),
        (sim.model, ["Wave", "speed", "2"]),
        (report, [report.rows[0][0], report.rows[0][1]]),
        (report.certificate, ["stability", report.certificate.verdict]),
    ):
        cells = Cells(shown._repr_html_()).found
        assert all(word in cells for word in words), (words, cells)
    assert "cracks" not in Cells(sim._repr_html_()).found  # there are none


def test_what_is_shown_is_escaped():
    class Odd(fh.LatticeModel):
        def __init__(self, note: str = "<script>alert(1)</script>") -> None:
            self.note, self.coefficient = note, 1.0

    fh.LatticeModel.known.pop("Odd")
    text = Odd()._repr_html_()
    assert "<script>" not in text and "<script>alert(1)</script>" in "".join(Cells(text).found)
    certificate = fh.Certificate("undecided", 'a < b & "c"', np.nan, 0.0, 1.0, (), ("<img src=x>",), 0.0)
    assert "<img" not in certificate._repr_html_() and "a &lt; b &amp;" in certificate._repr_html_()


def test_a_model_says_what_it_is():
    model = fh.Heat(fh.Kernel(2.0), density=2.0, integrator="rk4")
    assert repr(model).startswith("Heat(operator=Kernel(") and "density=2" in repr(model)
