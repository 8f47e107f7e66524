"""Results files written from Python contain what the run had, and lines: cracks, near field, layers."""

import signal

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.machine import uninterrupted
from farhorizon.simulation.time.output import edges


def line(**options):
    start = {"u": "exp(-2*x**2)"}
    lattice, model = fh.Lattice(0.25, -4, 4), fh.Wave(fh.Kernel(0.25))
    return fh.Simulation(lattice, model, fh.Fixed(), start, dt=fh.WholeSteps(every=0.5), **options)


def test_outputs_of_a_run_are_its_fields_at_their_times(tmp_path):
    path, receivers = tmp_path / "a.h5", fh.Receivers([0.3])
    sim = line(observe=[receivers])
    probes = sim.record([1.0])
    sim.run(2.0, every=0.5, output=path)
    results = fh.open_results(path)
    assert results.finished and results.field_names == ("u",) and results.provenance["numpy"] == np.__version__
    np.testing.assert_allclose(results.times, [0, 0.5, 1, 1.5, 2])
    for index, time in enumerate(results.times):
        np.testing.assert_array_equal(results.field("u", index), line().run(time).fields["u"])
    np.testing.assert_array_equal(results.probe_values, probes.values)
    np.testing.assert_array_equal(results.recorded["receivers"].data["u"], receivers.recorded.data["u"])
    assert len(probes.times) == len(receivers.recorded.times) == sim.step_count + 1  # in Python, records are kept
    assert results.energy[-1] == sim.energy()


def test_a_balance_is_written_where_it_is_recorded(tmp_path):
    lattice, model = fh.Lattice(0.25, -4, 4), fh.Diffusion(fh.Kernel(0.25))
    sim = fh.Simulation(lattice, model, fh.Fixed(), {"u": "exp(-2*x**2)"}, balance=True)
    sim.run(0.1, output=tmp_path / "a.h5")
    found = fh.open_results(tmp_path / "a.h5").balance
    assert {name: values[-1] for name, values in found.items()} == sim.balance()


def test_a_run_goes_on_with_the_file_that_it_has_begun(tmp_path):
    parts, whole = line(observe=[fh.Receivers([0.3])]), line(observe=[fh.Receivers([0.3])])
    for sim in (parts, whole):
        sim.record([1.0])
    for until in (1.0, 2.0, 3.0):
        parts.run(until, every=0.5, output=tmp_path / "parts.h5")
    whole.run(3.0, every=0.5, output=tmp_path / "whole.h5")
    one, other = (fh.open_results(tmp_path / f"{name}.h5") for name in ("parts", "whole"))
    for name in ("times", "steps", "energy", "probe_times", "probe_values"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.recorded["receivers"].data["u"], other.recorded["receivers"].data["u"])
    assert one.finished
    line().run(1.0, output=tmp_path / "parts.h5")  # another run starts a new file
    np.testing.assert_allclose(fh.open_results(tmp_path / "parts.h5").times, [0, 1])


def test_a_run_that_is_stopped_leaves_what_it_had(tmp_path):
    sim = line(observe=[lambda run: setattr(run, "stop_requested", run.time > 0.9)])
    sim.record([1.0])
    with pytest.raises(KeyboardInterrupt):
        sim.run(2.0, every=0.5, output=tmp_path / "a.h5")
    results = fh.open_results(tmp_path / "a.h5")
    np.testing.assert_allclose(results.times, [0, 0.5, 1])
    assert not results.finished and len(results.probe_times) == sim.step_count + 1 and len(sim.observers) == 1


@pytest.fixture
def ctrl_c():
    """Function that has the effect of Ctrl-C in a Python program, also where the tests handle it in another way."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield lambda: signal.raise_signal(signal.SIGINT)
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupted_run_continues_as_if_it_had_not_been(threads, ctrl_c, monkeypatch):
    """Ctrl-C in the compiled loop arrives when it returns, and waits until the run knows what the loop has done."""
    monkeypatch.setattr("farhorizon.engine.engine._PARALLEL_NUMBERS", 0)
    monkeypatch.setattr("farhorizon.simulation.setup.setup.available_threads", lambda: threads)
    whole, parts = line(), line()
    assert parts.engine.threads == threads
    for sim in (whole, parts):
        sim.record([1.0])
        sim.step(7)
    loop = parts.engine._compiled_loop

    def interrupted(*given):
        loop(*given)
        ctrl_c()

    monkeypatch.setattr(parts.engine, "_compiled_loop", interrupted)
    with pytest.raises(KeyboardInterrupt):
        parts.step(2000)
    assert 7 < parts.step_count < 2007
    monkeypatch.setattr(parts.engine, "_compiled_loop", loop)
    parts.step(2007 - parts.step_count)
    whole.step(2000)
    np.testing.assert_array_equal(parts.engine.levels, whole.engine.levels)
    np.testing.assert_array_equal(parts.probes.values, whole.probes.values)


def test_a_second_interrupt_acts_at_once(ctrl_c):
    """A function of the run's set-up may never end."""
    done = []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        ctrl_c()
        done.append("first")
        ctrl_c()
        done.append("second")
    assert done == ["first"]
    with pytest.raises(KeyboardInterrupt):  # as before
        ctrl_c()


def test_one_moment_is_written_with_the_fields_asked_for(tmp_path):
    sim = line()
    sim.step(9)
    assert sim.write(tmp_path / "now.h5", ["u", "v"]) == tmp_path / "now.h5"
    results = fh.open_results(tmp_path / "now.h5")
    assert results.finished and results.times == [sim.time] and results.case == ""
    for name in ("u", "v"):
        np.testing.assert_array_equal(results.field(name), sim.fields[name])


def test_fields_of_what_breaks_are_written(tmp_path):
    model = fh.Elastic(fh.Kernel(1.0), young=1.0, critical_stretch=0.1)
    sim = fh.Simulation(fh.Lattice(0.5, (-2, -2), (2, 2)), model, fh.Free(), {"u": ["0.01*x", 0.0]})
    sim.write(tmp_path / "solid.h5")
    results = fh.open_results(tmp_path / "solid.h5")
    assert results.field_names == ("u", "damage")
    np.testing.assert_array_equal(results.field("u"), sim.fields["u"])


def test_what_cannot_be_written_is_refused_before_the_run(tmp_path):
    sim = line()
    for wrong, message in (
        (lambda: sim.run(1.0, output=7), "run.output: must be a path; value: 7"),
        (lambda: sim.save(""), "path: must name a file; value: the text ''"),
        (lambda: sim.write("."), "path: must name a file; value: the text '.'"),
        (lambda: sim.run(1.0, output=tmp_path / "no" / "a.h5"), "there is no directory"),
        (lambda: sim.write(tmp_path / "a.h5", ["w"]), "fields: the run has no such field; value: .*w.*; limit: u, v"),
        (lambda: sim.write(tmp_path / "a.h5", "u"), "fields: must be a list of names of fields"),
    ):
        with pytest.raises(fh.InputError, match=message):
            wrong()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(fh.InputError, match="is not overwritten"):
        sim.write(tmp_path / "notes.txt")
    assert sim.step_count == 0 and [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def plane(**options):
    lattice = fh.Lattice(0.5, (-2.0, -1.0), (2.0, 1.0))
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), initial={"u": "exp(-9*(x**2 + y**2))"}, **options)


def test_a_file_has_the_lines_of_its_run(tmp_path):
    sides = {"x": fh.LatticePML(nodes=4), "y-": fh.Fixed(), "y+": fh.Sponge(nodes=6)}
    crack = [(-1.0, 0.3), (0.0, 0.3), (1.0, 0.7)]
    sim = plane(boundary=sides, cracks=[crack, fh.Crack([(0.2, -0.8), (0.2, -0.6)], opens=9.0)])
    found = fh.open_results(sim.write(tmp_path / "a.h5")).outlines
    assert list(found) == ["cracks", "near field", "layers"] and len(found["cracks"]) == 2
    np.testing.assert_array_equal(found["cracks"][0], crack)
    ((x, y), _, (right, top), _, last) = found["near field"][0]
    assert (x, y, right, top) == (-2, -1, 2, 1) and tuple(last) == (x, y)
    (layers,) = found["layers"]
    np.testing.assert_allclose((layers.min(0), layers.max(0)), [(-4, -1), (4, 4)])


def test_without_cracks_and_layers_there_is_the_near_field(tmp_path):
    line = fh.Simulation(fh.Lattice(0.5, -2, 2), fh.Wave(fh.Kernel(0.5)), fh.Fixed())
    found = fh.open_results(line.write(tmp_path / "a.h5")).outlines
    assert list(found) == ["near field"] and [p.tolist() for p in found["near field"]] == [[[-2.0]], [[2.0]]]


CUTS = {
    "point": (fh.PointCut(0.3), 1, 0.0),
    "polyline": (fh.Polyline([(0.0, 0.0), (3.0, 4.0)]), 2, 5.0),
    "rectangle": (fh.Rectangle((0, 0, 1), (2, 0, 0), (0, 3, 0)), 5, 10.0),
    "disc": (fh.DiscCut((1, 2, 3), (1, 1, 1), 2.0), 49, 4 * np.pi),
    "polygon": (fh.PolygonCut([(0, 0, 1), (3, 0, 1), (3, 4, 1)]), 4, 12.0),
}


@pytest.mark.parametrize("name", CUTS)
def test_outlines_of_cuts_lie_on_them(name):
    """The outline has the length of the rim, and its extent is the bounds of the cut."""
    cut, count, length = CUTS[name]
    line = cut.outline()
    assert line.shape == (count, cut.dim)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(length, rel=1e-3)
    np.testing.assert_allclose((line.min(0), line.max(0)), cut.bounds(), atol=0.01)


def test_edges_of_a_cube():
    lines = edges(np.zeros(3), np.array([1.0, 2.0, 3.0]))
    assert len(lines) == 12 and sum(np.ptp(line, axis=0).sum() for line in lines) == 4 * (1 + 2 + 3)
    assert len({tuple(sorted(map(tuple, line.tolist()))) for line in lines}) == 12


@pytest.mark.parametrize("dim", [1, 2])
def test_vtk_reads_the_lines(tmp_path, dim):
    vtk = pytest.importorskip("vtk")
    if dim == 2:
        sim = plane(cracks=[[(-1.0, 0.3), (1.0, 0.7)]], boundary=fh.LatticePML(nodes=4))
    else:
        sim = fh.Simulation(fh.Lattice(0.5, -2, 2), fh.Wave(fh.Kernel(0.5)), fh.Fixed(), cracks=[0.3])
    results = fh.open_results(sim.write(tmp_path / "a.h5"))
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(results.write_outlines(tmp_path / "a.vtp")))
    reader.Update()
    read = reader.GetOutput()
    lines = [line for some in results.outlines.values() for line in some]
    assert read.GetNumberOfCells() == len(lines)
    assert (read.GetNumberOfVerts(), read.GetNumberOfLines()) == ((0, 3) if dim == 2 else (3, 0))
    for number, line in enumerate(lines):
        cell = read.GetCell(number)
        places = [cell.GetPoints().GetPoint(k)[:dim] for k in range(cell.GetNumberOfPoints())]
        np.testing.assert_array_equal(places, line)
    kinds = [read.GetCellData().GetArray("kind").GetTuple1(k) for k in range(len(lines))]
    assert kinds == [k for k, some in enumerate(results.outlines.values()) for _ in some]
    with pytest.raises(fh.InputError, match="there is no directory"):
        results.write_outlines(tmp_path / "no" / "a.vtp")


def test_pictures_of_a_run_show_its_cracks():
    panel = plane(boundary=fh.Fixed(), cracks=[[(-1.0, 0.3), (1.0, 0.7)]]).plot("u").axes[0]
    assert any(np.array_equal(line.get_xydata(), [(-1.0, 0.3), (1.0, 0.7)]) for line in panel.lines)
