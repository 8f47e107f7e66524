"""Long computations report their progress if stderr is a terminal."""

import pytest

import farhorizon as fh
from farhorizon.studies.compare import compare
from helpers import lattice_of


def small():
    data = {"u": "exp(-((x - 7)**2 + (y - 7)**2)/4)"}
    return fh.Simulation(lattice_of((15, 15)), fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=4), data)


@pytest.mark.parametrize("looked_at", [False, True])
def test_runs_and_comparisons(looked_at, capsys, monkeypatch):
    """Progress is printed if stderr is a terminal, and only then."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: looked_at)
    sim = small()
    sim.run(5.0)
    assert ("step" in capsys.readouterr().err) == looked_at
    compare(sim.setup, 5.0)
    assert ("step" in capsys.readouterr().err) == looked_at


@pytest.mark.parametrize("looked_at", [False, True])
def test_certificates(looked_at, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: looked_at)
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))
    small().certificate()
    assert ("stability: " in capsys.readouterr().err) == looked_at
