"""Example 1 and table 1 of Shojaei et al. (2020)."""

import numpy as np
import pytest

from farhorizon.boundaries import Fixed, LatticePML
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.papers import REPRODUCTIONS
from farhorizon.papers import shojaei2020 as paper
from farhorizon.papers.measure import infinite, measured_run, stability

COARSE = 0.005  # five times the paper's step: errors of the conditions change in the third digit


def largest(setup, boundary):
    """Return the largest error at t = 250, relative to the largest value at that time."""
    reference = infinite(setup, paper.END)
    found = measured_run(setup, boundary, [paper.END], reference)
    return found.errors[0] / np.abs(reference(round(paper.END / setup["dt"]))).max()


def test_table_1(tmp_path):
    """All 14 entries and the series, which are correct as printed."""
    found = REPRODUCTIONS.find("shojaei2020-table1").run(tmp_path).rows
    assert len(found) == 14 + 4
    assert max(abs(row.deviation) for row in found) < 1e-12


@pytest.mark.parametrize(
    "operator, layer, radius, wavenumber, known",
    [
        (Kernel(0.5, 1), 4, 2, 11.3, 0.36),
        (Kernel(0.5, 1), 4, 2, 1.0, 0.072),
        (Kernel(0.5, 1), 4, 2, 0.25, 0.028),
        (Stencil.finite_element(1), 1, 2, 0.2, 0.01),
    ],
)
def test_example_1(operator, layer, radius, wavenumber, known):
    """Largest errors against an independent program; the advice of eq 47 is as bad as a value held at zero."""
    setup = {**paper.line(operator, layer), "dt": COARSE}
    assert largest(setup, paper.published(wavenumber, radius)) == pytest.approx(known, rel=0.1)


def test_held_at_zero_and_lattice_pml():
    setup = {**paper.line(Kernel(0.5, 1), 4), "dt": COARSE}
    assert largest(setup, Fixed()) == pytest.approx(0.41, rel=0.02)  # by an independent program
    assert largest(setup, LatticePML()) < 1e-5


def test_stability():
    """The published layers are certified for four spacings and refused for one; that fixed ends do not grow is
    proved.
    """
    assert stability(paper.line(Kernel(0.5, 1), 4), paper.published(0.25), COARSE)[0] < 0
    less_one, how = stability(paper.line(Kernel(0.5, 1), 1), paper.published(0.25, layer=1), COARSE)
    assert less_one > 0.01 and how == "not certified"
    assert stability(paper.line(Stencil.finite_element(1), 1), Fixed(), COARSE) == (0.0, "at most: proof")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shojaei2020-ex1-fem", "shojaei2020-ex1-pd", "shojaei2020-ex1-layers"])
def test_reproductions(name, tmp_path):
    entry = REPRODUCTIONS.find(name)
    outcome = entry.run(tmp_path)
    assert all(path.stat().st_size > 20_000 for path in outcome.pictures)
    assert {f"shojaei2020-{figure}.png" for figure in entry.figures} <= {path.name for path in outcome.pictures}
    assert outcome.unexplained(0.05) == []
    # the energy falls and that of a thinner layer is wrong, as the paper says; its fields are open (see the reasons)
    said = {found.item: found.agrees for found in outcome.comparisons}
    assert all(said.get(f"figure {n}", True) for n in (7, 8, 9, 11))
    if "lattice PML" in outcome.infinite_error:
        assert outcome.infinite_error["lattice PML"] < 1e-6
