"""Nothing depends on units: the examples in SI (millimetres, microseconds) give the same fields and the same
verdicts.
"""

from pathlib import Path

import numpy as np
import pytest

from farhorizon.case.case import Case
from scaling import in_units

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.toml"))
SI = (1e-3, 1e-6, 1e-6)
SOON = {
    "backward_waves": 0.2,
    "blob": 0.2,
    "inclusion": 0.1,
    "crack_scattering": 0.1,
    "quenched_bar": 1.0,
    "exact_bar": 0.3,
    "layered_ground": 0.1,
}


@pytest.fixture(autouse=True)
def fresh(tmp_path, monkeypatch):
    """No certificate of an earlier run is reused for one of the two."""
    monkeypatch.setattr("farhorizon.checks.certificate.cache_folder", lambda: tmp_path)


def verdict(run, until):
    """Return what the certificate states for a given time, and whether it refuses the run."""
    run.prepare(until)
    found = run.certificate(60.0, until)
    return found.verdict, found.grows_within(until)


def in_both(path, share):
    """Return the run of an example and the same in SI, each with its end at a fraction of the example's time."""
    text = path.read_text()
    cases = Case(text, path), Case(in_units(text, *SI), path)
    return [(case.run(), case.parts.run.until * share) for case in cases]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "path, share",
    [
        *(pytest.param(p, SOON[p.stem], id=p.stem) for p in EXAMPLES if p.stem in SOON),
        *(pytest.param(p, 1.0, id=f"{p.stem}, whole", marks=pytest.mark.slow) for p in EXAMPLES),
    ],
)
def test_examples_in_si(path, share, monkeypatch):
    # other runs may have established more about one of the two
    monkeypatch.setattr("farhorizon.checks.certificate._recall", lambda path: None)
    (plain, until), (scaled, later) = in_both(path, share)
    known, refused = verdict(plain, until)
    assert verdict(scaled, later) == (known, refused)
    assert scaled.dt == pytest.approx(plain.dt * SI[1], rel=1e-12)
    length = SI[0] if plain.fields["u"].ndim > plain.lattice.dim else 1.0
    largest = float(np.nanmax(np.abs(plain.fields["u"])))  # over the whole run: waves come and leave
    for part in () if refused else np.arange(1, 9) / 8:
        plain.run(part * until)
        largest = max(largest, float(np.nanmax(np.abs(plain.fields["u"]))))
    if not refused:
        scaled.run(later)
    assert plain.step_count == scaled.step_count
    one, other = plain.fields["u"], scaled.fields["u"] / length
    # where layers keep six digits of their memory, rounding differs if u has another unit
    halves = length != 1 and plain.engine.kept != plain.engine.dtype
    np.testing.assert_allclose(other, one, rtol=0, atol=(1e-6 if halves else 1e-9) * largest)
