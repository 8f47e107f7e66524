"""Cases to start from: each passes its check and runs."""

import numpy as np
import pytest

from farhorizon.case.case import Case
from farhorizon.case.templates import KINDS, brief, template
from farhorizon.cli import main
from farhorizon.files.results import open_results


def test_all_are_listed():
    from importlib.resources import files

    there = {path.name for path in files("farhorizon.case.templates").iterdir() if path.name.endswith(".toml")}
    assert there == {f"{kind}.toml" for kind in KINDS}
    assert all(brief(kind)[0].isupper() and "farhorizon keys" in template(kind) for kind in KINDS)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", KINDS)
def test_a_template_passes_check_and_runs(kind, tmp_path, monkeypatch, capsys):
    """It takes seconds by the estimate of the check, something happens in it, and there are no cautions."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind, "-o", f"{kind}.toml"]) == 0
    case = Case.read(f"{kind}.toml")
    sim = case.run()
    report = sim.check(case.parts.run.until, 0.1)
    assert not report.refused and report.numbers["seconds"] < 20  # on a machine that has other work
    assert main(["run", f"{kind}.toml"]) == 0
    results = open_results(f"{kind}.h5")
    assert results.finished and not results.cautions and len(results.times) > 10
    assert np.ptp(results.field(results.field_names[0], -1)[np.isfinite(results.field(results.field_names[0], -1))]) > 0
    assert results.times[-1] == pytest.approx(case.parts.run.until)
