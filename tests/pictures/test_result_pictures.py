"""Pictures of a results file: what is drawn, when, where and how."""

import itertools

import numpy as np
import pytest
from matplotlib.figure import Figure

from drawn import axes_of, is_picture, wave
from farhorizon.errors import InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.files.results import open_results
from farhorizon.files.results_layout import Caution
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.pictures import fields, movie
from farhorizon.pictures import result_pictures as drawing
from farhorizon.pictures.deformed import deformed_cells
from farhorizon.pictures.panels import Panel
from farhorizon.pictures.views import View

SQUARE = {"shape": (9, 9), "spacing": 1.0, "lower": (0.0, 0.0), "dtype": "float64"}


def write_results(path, dim, outputs=6, observed=True):
    axes = axes_of(dim, 11)
    shape = tuple(a.size for a in axes)
    probes = np.zeros((2, dim)) if observed else None
    writer = ResultsWriter.create(
        path, shape=shape, spacing=0.2, lower=(-1.0,) * dim, fields=("u", "v"), dtype="float64", probes=probes
    )
    for k in range(outputs):
        data = {"u": wave(axes, k), "v": np.abs(wave(axes, k))}
        writer.append(k, float(k), data, np.exp(-2.0 * k) if observed else None)
        if observed:
            writer.append_probes(k + np.array([0.0, 0.5]), np.array([[k, -k], [k, 0.0]]))
    return open_results(path)


def test_panels_share_a_scale_unless_some_would_be_empty(tmp_path, monkeypatch):
    """A wave that leaves remains visible; fields of similar size, or that start from zero, share one scale; zeros are
    omitted.
    """
    seen = []
    monkeypatch.setattr(
        drawing, "field_panels", lambda panels, _axes, _path, look: seen.append((len(panels), look.shared))
    )
    for run, amplitudes in enumerate(([1.0, 0.5, 0.3], [1.0, 0.01, 0.001], [0.0, 1.0, 0.5], [0.0, 0.0, 0.0])):
        path = tmp_path / f"{run}.h5"
        writer = ResultsWriter.create(path, shape=(5,), spacing=1.0, lower=(0.0,), fields=("u",), dtype="float64")
        for k, amplitude in enumerate(amplitudes):
            writer.append(k, float(k), {"u": np.full(5, amplitude)})
        drawing.plot_results(open_results(path), tmp_path)
    assert seen == [(3, True), (3, False), (2, True)]  # there is nothing to show in the last one


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_plot_results(tmp_path, dim):
    results = write_results(tmp_path / "a.h5", dim)
    paths = drawing.plot_results(results, tmp_path / "new" / "pictures")
    assert [p.name for p in paths] == ["u.png", "v.png", "probes.png", "energy.png"]
    assert all(is_picture(p) for p in paths)


@pytest.mark.parametrize(("outputs", "expected"), [(0, []), (1, ["u.png", "v.png"])])
def test_plot_few_outputs(tmp_path, outputs, expected):
    results = write_results(tmp_path / "a.h5", 2, outputs, observed=False)
    assert [p.name for p in drawing.plot_results(results, tmp_path)] == expected
    assert [p.name for p in drawing.plot_results(results, tmp_path, View(times=[0.0]))] == expected


@pytest.mark.parametrize(
    ("times", "titles"), [(None, ["t = 0", "t = 2", "t = 3", "t = 5"]), ([1.2, 0.9, 99.0], ["t = 1", "t = 5"])]
)
def test_chosen_times(tmp_path, monkeypatch, times, titles):
    """Up to four evenly spaced outputs are drawn, or the nearest to the requested times, each once."""
    results = write_results(tmp_path / "a.h5", 1)
    seen = []
    monkeypatch.setattr(drawing, "field_panels", lambda panels, *_: seen.append([panel.title for panel in panels]))
    drawing.plot_results(results, tmp_path, View(times=times))
    assert seen == [titles, titles]
    with pytest.raises(InputError, match="finite"):
        View(times=[np.nan])


def axes_and_fields(path, dim=2, outputs=4, vector=True, units=None):
    """Return a results file with a vector or scalar u, zero at first, and a scalar v."""
    axes = axes_of(dim, 9)
    shape = tuple(a.size for a in axes)
    writer = ResultsWriter.create(
        path,
        shape=shape,
        spacing=0.25,
        lower=(-1.0,) * dim,
        fields=("u", "v"),
        dtype="float64",
        components={"u": dim if vector else 1, "v": 1},
        units=units,
    )
    for k in range(outputs):
        u = np.zeros((dim, *shape)) if vector else np.zeros(shape)
        (u[0] if vector else u)[...] = k * wave([0.25 * np.arange(n) for n in shape], k)
        writer.append(k, 0.5 * k, {"u": np.nan_to_num(u), "v": np.full(shape, 1.0 + k)})
    return open_results(path)


def test_zeros_are_left_out_and_said(tmp_path):
    said = []
    results = axes_and_fields(tmp_path / "a.h5")
    paths = drawing.plot_results(results, tmp_path, say=said.append)
    assert [p.name for p in paths] == ["u.png", "u_x.png", "v.png"]
    assert said == [
        "|u| is zero everywhere at t = 0: left out",
        "u_x is zero everywhere at t = 0: left out",
        "u_y is zero everywhere: no picture",
    ]


def test_rounding_is_left_out_unless_a_scale_shows_it(tmp_path):
    """The first of three outputs is 1e-7 times as large as the others."""
    writer = ResultsWriter.create(
        tmp_path / "a.h5", shape=(9,), spacing=0.25, lower=(0.0,), fields=("u",), dtype="float64"
    )
    for k, size in enumerate((1e-7, 1.0, 0.5)):
        writer.append(k, float(k), {"u": size * np.sin(np.arange(9.0))})
    results, said = open_results(tmp_path / "a.h5"), []
    drawing.plot_results(results, tmp_path, say=said.append)
    assert said == ["u is below 1e-06 of its largest value at t = 0: left out"]
    for view in (View(decibels=True), View(limits=(-1e-6, 1e-6))):
        drawing.plot_results(results, tmp_path, view, say=said.append)
    assert len(said) == 1


def test_fields_and_components_are_chosen(tmp_path):
    results = axes_and_fields(tmp_path / "a.h5")
    view = View(fields=["v", "u_x", "v"], format="svg")
    assert [p.name for p in drawing.plot_results(results, tmp_path, view)] == ["v.svg", "u_x.svg"]
    with pytest.raises(InputError, match=r"no such field; value: w; limit: u, u_x, u_y, v, u_divergence, u_curl"):
        drawing.plot_results(results, tmp_path / "new", View(fields=["w"]))
    with pytest.raises(InputError, match="unknown format; value: jpg; limit: png, pdf, svg"):
        View(format="jpg")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("dim", [2, 3])
def test_divergence_and_curl_are_those_of_the_displacements(tmp_path, monkeypatch, dim):
    """Differences of second order are exact for second powers: ``u = (x^2 + 3 y, x y, ...)``."""
    shape, path, seen = (7, 8, 9)[:dim], tmp_path / "a.h5", {}
    x, y, *z = (0.5 * i for i in np.indices(shape))
    u = np.stack([x**2 + 3 * y, x * y, *(x * one for one in z)])
    writer = ResultsWriter.create(
        path, shape=shape, spacing=0.5, lower=(0.0,) * dim, fields=("u",), components={"u": dim}, dtype="float64"
    )
    writer.append(0, 0.0, {"u": u})
    for name in ("field_panels", "slice_panels"):
        monkeypatch.setattr(drawing, name, lambda panels, _a, _p, look: seen.update({look.label: panels[0].values}))
    drawing.plot_results(open_results(path), tmp_path, View(fields=["u_divergence", "u_curl"]))
    rotation = np.sqrt((y - 3) ** 2 + z[0] ** 2) if z else y - 3
    np.testing.assert_allclose(seen[r"divergence $\nabla \cdot u$"], 3 * x + (x if z else 0), atol=1e-12)
    np.testing.assert_allclose(seen[r"curl $\nabla \times u$"], rotation, atol=1e-12)
    assert len(drawing.plot_results(open_results(path), tmp_path)) == 1 + dim  # they are drawn only on request


def test_films_and_surfaces_tell_divergence_and_curl_as_pictures_do(tmp_path, monkeypatch):
    """They are labelled as numbers without a unit, not as displacements."""
    path, seen = tmp_path / "a.h5", []
    writer = ResultsWriter.create(
        path,
        shape=(6, 6, 6),
        spacing=0.5,
        lower=(0.0,) * 3,
        fields=("u",),
        components={"u": 3},
        dtype="float64",
        units={"u": "mm"},
    )
    for k in range(2):
        writer.append(k, float(k), {"u": (1.0 + k) * np.stack(np.indices((6, 6, 6), float))})

    def film(frames, _axes, path, look):
        seen.append((look.label, frames[0].title))
        return [path]

    def surfaces(_panels, _axes, _path, look, _levels):
        seen.append((look.label, look.title))
        return Figure()

    monkeypatch.setattr(drawing, "movie", film)
    monkeypatch.setattr(drawing, "isosurface_panels", surfaces)
    for wanted in ({"movie": True}, {"isosurfaces": ()}):
        view = View(fields=["u_divergence", "u"], quantities={"u": "displacement"}, **wanted)
        drawing.plot_results(open_results(path), tmp_path, view)
    divergence, length = r"divergence $\nabla \cdot u$", "displacement $|u|$ (mm)"
    assert {(divergence, "t = 0"), (divergence, ""), (length, "t = 0"), (length, "")} == set(seen)


@pytest.mark.parametrize("normal", ["x", "y", "z"])
def test_a_slice_is_that_of_its_plane(tmp_path, monkeypatch, normal):
    """The nearest plane of nodes is drawn on the other two axes with their names; cracks are projected onto it."""
    seen = []
    monkeypatch.setattr(fields, "_images", lambda *given: seen.append(given))
    results = axes_and_fields(tmp_path / "a.h5", dim=3)
    axis = "xyz".index(normal)
    crack = np.arange(6.0).reshape(2, 3)
    view = View(planes=[(normal, 0.13)], fields=["v"], times=[1.0], cracks=[crack])
    drawing.plot_results(results, tmp_path, view)
    index = int(np.abs(results.axes[axis] - 0.13).argmin())
    (((panel,), axes, _, look, names),) = seen
    np.testing.assert_array_equal(panel.values, results.field("v", 2).take(index, axis))
    assert names == "xyz".replace(normal, "") and f"{normal} = {results.axes[axis][index]:g}" in look.title
    np.testing.assert_array_equal(look.cracks[0], np.delete(crack, axis, 1))
    assert [len(a) for a in axes] == list(panel.values.shape)
    with pytest.raises(InputError, match=rf"outside the near field; value: {normal} = 9; limit: -1 to"):
        drawing.plot_results(results, tmp_path, View(planes=[(normal, 9.0)]))


def test_three_slices_have_a_picture_each(tmp_path):
    results = axes_and_fields(tmp_path / "a.h5", dim=3)
    said, view = [], View(planes=[("x", 0.0), ("y", 0.5), ("z", 0.0)], fields=["u_x"])
    made = drawing.plot_results(results, tmp_path, view, said.append)
    assert [p.name for p in made] == ["u_x-x=0.png", "u_x-y=0.5.png", "u_x-z=0.png"] and len(said) == 1
    assert all(map(is_picture, made)) and len({p.read_bytes() for p in made}) == 3


def test_in_space_the_three_planes_through_the_middle_are_in_one_picture(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(fields, "image_of", drawing_of(fields.image_of, drawn))
    results = axes_and_fields(tmp_path / "a.h5", dim=3)
    crack = np.arange(6.0).reshape(2, 3)
    (made,) = drawing.plot_results(results, tmp_path, View(fields=["u_x"], times=[0.5, 1.0], cracks=[crack]))
    assert made.name == "u_x.png" and is_picture(made)
    for ((_, panel, axes, _, look, _), _), (k, axis) in zip(drawn, itertools.product((1, 2), range(3)), strict=True):
        middle = results.shape[axis] // 2
        np.testing.assert_array_equal(panel.values, results.field("u", k)[0].take(middle, axis))
        np.testing.assert_array_equal(look.cracks[0], np.delete(crack, axis, 1))
        assert [len(line) for line in axes] == list(panel.values.shape)


def drawing_of(function, seen):
    """Return a function that records its arguments."""

    def noting(*given, **named):
        seen.append((given, named))
        return function(*given, **named)

    return noting


@pytest.mark.parametrize("dim", [2, 3])
def test_what_is_broken_and_regions_are_drawn_over_fields(tmp_path, monkeypatch, dim):
    """Broken bonds are dark, and media have outlines and names; the damage itself is drawn as it is."""
    axes = axes_of(dim, 11)
    shape = tuple(axis.size for axis in axes)
    numbers = np.zeros(shape, np.int32)
    numbers[6:] = 1
    regions = Regions(numbers, ("rock, young = 1", "young = 2"))
    damage = np.zeros(shape)
    damage[5] = 0.5
    options = {"shape": shape, "spacing": 0.2, "lower": (-1.0,) * dim, "fields": ("u", "damage"), "dtype": "float64"}
    writer = ResultsWriter.create(tmp_path / "a.h5", regions=regions, **options)
    writer.append(0, 0.0, {"u": wave(axes, 1), "damage": damage})
    drawn = []
    monkeypatch.setattr(fields, "image_of", drawing_of(fields.image_of, drawn))
    made = drawing.plot_results(open_results(tmp_path / "a.h5"), tmp_path)
    assert [path.name for path in made] == ["u.png", "damage.png"] and all(map(is_picture, made))
    images = [(panel, look, named) for (_, panel, _, _, look, named), _ in drawn]
    of_u, of_damage = images[: len(images) // 2], images[len(images) // 2 :]
    planes = [(damage, numbers)] if dim == 2 else [(damage.take(5, a), numbers.take(5, a)) for a in range(3)]
    for (panel, look, named), (broken, region) in zip(of_u, planes, strict=True):
        np.testing.assert_array_equal(panel.broken, broken)
        np.testing.assert_array_equal(look.regions.numbers, region)
        assert look.smooth and named
    assert all(panel.broken is None and not look.smooth for panel, look, _ in of_damage)


def test_decibels_are_below_the_largest(tmp_path, monkeypatch):
    seen = {}
    monkeypatch.setattr(
        drawing, "field_panels", lambda panels, _a, _p, look: seen.update(look._asdict(), panels=panels)
    )
    results = axes_and_fields(tmp_path / "a.h5")
    drawing.plot_results(results, tmp_path, View(decibels=True, fields=["v"], times=[0.0, 1.5]))
    found = [panel.values for panel in seen["panels"]]
    np.testing.assert_allclose(found[0], 20 * np.log10(1 / 4))
    np.testing.assert_allclose(found[1], 0.0, atol=1e-12)
    assert seen["limits"] == (-60.0, 0.0) and seen["shared"] and "dB" in seen["label"]
    drawing.plot_results(results, tmp_path, View(decibels=True, fields=["u"], limits=(-30, 0)))
    lowest = min(np.nanmin(panel.values) for panel in seen["panels"])
    assert lowest == -30 and all(np.isfinite(panel.values).all() for panel in seen["panels"])


def test_a_deformed_lattice_has_its_nodes_where_they_moved(tmp_path, monkeypatch):
    from matplotlib.collections import PolyCollection

    drawn = []
    whole = PolyCollection.__init__
    monkeypatch.setattr(PolyCollection, "__init__", lambda c, v, **k: drawn.append(np.array(v)) or whole(c, v, **k))
    results = axes_and_fields(tmp_path / "a.h5")
    view = View(deformed=3.0, times=[1.5])
    assert [p.name for p in drawing.plot_results(results, tmp_path, view)] == ["deformed.png"]
    assert is_picture(tmp_path / "deformed.png")
    cells = deformed_cells(3 * results.field("u", 3), results.axes)
    np.testing.assert_array_equal(drawn[0], cells.reshape(-1, 4, 2))
    drawing.plot_results(results, tmp_path, View(deformed=0.0))  # including the output at rest
    with pytest.raises(InputError, match="--deformed: only a run in 2D with displacements"):
        scalar = axes_and_fields(tmp_path / "b.h5", vector=False)
        drawing.plot_results(scalar, tmp_path, View(deformed=0.0))
    with pytest.raises(InputError, match=r"--deformed: .*value: 2D, no u"):
        damaged = axes_and_fields(tmp_path / "c.h5")
        damaged.field_names, damaged.components = ("v",), {"v": 2}
        drawing.plot_results(damaged, tmp_path, View(deformed=0.0))
    with pytest.raises(InputError, match="factor must be positive"):
        View(deformed=-1.0)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_film_has_every_output(tmp_path, dim):
    from PIL import Image

    results = axes_and_fields(tmp_path / "a.h5", dim=dim, vector=dim == 2)
    first, *rest = drawing.plot_results(results, tmp_path, View(movie=True))
    with Image.open(first) as film:
        assert first.name == "u.gif" and film.n_frames == 4
    assert [p.name for p in rest] in ([], ["u.mp4"])
    assert {p.name for p in tmp_path.iterdir()} == {"a.h5", first.name, *(p.name for p in rest)}


@pytest.mark.parametrize("dim", [2, 3])
def test_the_bar_of_a_film_has_the_same_arrows_in_all_frames(monkeypatch, dim):
    """The arrows are those for visible values beyond the scale in any frame: an arrow that comes and goes would
    flicker.
    """
    axes = axes_of(dim)
    field = np.nan_to_num(wave(axes, 0))
    loud = 9 * field
    broken = np.zeros(field.shape)
    frames, seen = [Panel(f"{k}", values) for k, values in enumerate((loud, field, field))], []
    monkeypatch.setattr(movie, "field_panels", drawing_of(movie.field_panels, seen))
    movie.made_film(frames, axes)
    assert {look.beyond for (*_, look), _ in seen} == {"both"}
    bars = [movie.field_panels(*given).axes[-1]._colorbar.extend for given, _ in seen[:]]
    assert bars == ["both"] * 3
    seen.clear()
    broken[np.abs(loud) > np.abs(field).max()] = 1.0
    hidden = (broken, 0 * broken, 0 * broken)
    movie.made_film([frame._replace(broken=one) for frame, one in zip(frames, hidden, strict=True)], axes)
    assert {look.beyond for (*_, look), _ in seen} == {"neither"}


def test_a_film_of_one_output_is_refused(tmp_path):
    results = axes_and_fields(tmp_path / "a.h5")
    with pytest.raises(InputError, match="--movie: a film needs two outputs or more; value: 1"):
        drawing.plot_results(results, tmp_path, View(movie=True, times=[1.0]))
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_mp4(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    paths = drawing.plot_results(axes_and_fields(tmp_path / "a.h5"), tmp_path, View(movie=True, fields=["v"]))
    facts = next(ffmpeg.read_frames(str(paths[1])))
    assert paths[1].name == "v.mp4" and facts["codec"] == "h264" and min(facts["size"]) > 100


def test_what_makes_a_run_doubtful_is_told_once_beside_its_marks(tmp_path, monkeypatch):
    """Panels from that time on have a mark; a long text in each of them would cover the next."""
    writer = ResultsWriter.create(tmp_path / "a.h5", **SQUARE, fields=("u",))
    cautions = [Caution(2.0, "crack where bonds cannot break", "...")]
    for k in range(4):
        writer.append(k, float(k), {"u": np.full((9, 9), 1.0 + k)}, cautions=cautions if k > 1 else ())
    seen = {}
    monkeypatch.setattr(drawing, "field_panels", lambda panels, _a, _p, look: seen.update({look.title: panels}))
    drawing.plot_results(open_results(tmp_path / "a.h5"), tmp_path)
    ((title, panels),) = seen.items()
    assert title == "* crack where bonds cannot break"
    assert [panel.title for panel in panels] == ["t = 0", "t = 1", "t = 2*", "t = 3*"]


def test_cracks_that_are_drawn_as_lines_are_not_drawn_as_broken_bonds_too(tmp_path, monkeypatch):
    """Only bonds that break later are dark; without lines all broken bonds are."""
    damage = np.zeros((2, 9, 9))
    damage[:, 3:5, 4:6], damage[1, 5, 4:6] = 0.4, 0.3
    writer = ResultsWriter.create(tmp_path / "a.h5", **SQUARE, fields=("u", "damage"))
    for k in range(2):
        writer.append(k, float(k), {"u": np.full((9, 9), 1.0 + k), "damage": damage[k]})
    seen = []
    monkeypatch.setattr(drawing, "field_panels", lambda panels, *_: seen.append(np.array([p.broken for p in panels])))
    for cracks in ([], [np.array([[3.5, 4.0], [3.5, 5.0]])]):
        drawing.plot_results(open_results(tmp_path / "a.h5"), tmp_path, View(fields=["u"], cracks=cracks))
    np.testing.assert_allclose(seen[0], damage, atol=1e-7)
    np.testing.assert_allclose(seen[1], damage - damage[0], atol=1e-7)
    frames = []
    monkeypatch.setattr(movie, "field_panels", drawing_of(movie.field_panels, frames))
    drawing.plot_results(open_results(tmp_path / "a.h5"), tmp_path, View(fields=["u"], cracks=cracks, movie=True))
    over = [panel.broken for ((panel,), *_), _ in frames][:2]  # a film in another format draws them again
    np.testing.assert_allclose(over, damage - damage[0], atol=1e-7)


def test_colours_are_named_in_words_with_units(tmp_path, monkeypatch):
    names = ("u", "stress_von_mises", "stress_xy", "damage")
    options = {"components": {name: 1 + (name == "u") for name in names}, "units": {"u": "mm", "stress": "GPa"}}
    writer = ResultsWriter.create(tmp_path / "a.h5", **SQUARE, fields=names, **options)
    scalar = np.ones((9, 9))
    writer.append(0, 0.0, {"u": np.ones((2, 9, 9)), **dict.fromkeys(names[1:], scalar)})
    seen = []
    monkeypatch.setattr(drawing, "field_panels", lambda *given: seen.append(given[3].label))
    results, view = open_results(tmp_path / "a.h5"), {"quantities": {"u": "displacement"}}
    drawing.plot_results(results, tmp_path, View(**view))
    length, x, y = (f"displacement ${one}$ (mm)" for one in ("|u|", "u_{x}", "u_{y}"))
    assert seen == [length, x, y, "von Mises stress (GPa)", r"stress $\sigma_{xy}$ (GPa)", "damage"]
    labels = []
    monkeypatch.setattr(drawing, "deformed_panels", lambda *given: labels.append(given[3].label))
    drawing.plot_results(results, tmp_path, View(deformed=1.0, **view))
    assert labels == ["damage"]


def test_the_lengths_that_colour_a_deformed_lattice_have_a_unit(tmp_path, monkeypatch):
    results, labels = axes_and_fields(tmp_path / "a.h5", units={"u": "mm"}), []
    monkeypatch.setattr(drawing, "deformed_panels", lambda *given: labels.append(given[3].label))
    drawing.plot_results(results, tmp_path, View(deformed=1.0, quantities={"u": "displacement"}))
    assert labels == ["displacement $|u|$ (mm)"]


def test_pictures_of_chosen_times_may_have_names_of_their_own(tmp_path):
    results = axes_and_fields(tmp_path / "a.h5")
    view = {"times": [1.0], "suffix": "-t=1"}
    assert [path.name for path in drawing.plot_results(results, tmp_path, View(**view, fields=["v"]))] == ["v-t=1.png"]
    assert [path.name for path in drawing.plot_results(results, tmp_path, View(**view, deformed=1.0))] == [
        "deformed-t=1.png"
    ]
