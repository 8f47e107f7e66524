"""A few cases of the fuzzers, killers and damagers in this folder, and thousands of them in the slow tests.

Each prints its seed; FARHORIZON_SEED repeats it. For more cases, on more cores, run the scripts themselves.
"""

import os
import sys

import arguments
import damage
import fences
import foreign
import fuzz
import kill
import machinery
import pytest

PROCESSES = 2 if (os.cpu_count() or 1) > 1 else 1


@pytest.mark.parametrize("count", [12, pytest.param(2000, marks=pytest.mark.slow)])
def test_random_cases_run_or_are_refused(count, tmp_path):
    """No traceback, crash or hang, finite fields, and bitwise resumption. The fast tier always has the same cases to
    save time: none in single precision uses kernels that would have to be compiled for it alone.
    """
    counts = fuzz.campaign(count, 40 if count == 12 else machinery.seed_of(), PROCESSES, tmp_path)
    assert not {name: counts[name] for name in fuzz.BAD if counts[name]}
    assert counts["accepted"] > 0.4 * count


@pytest.mark.skipif(sys.platform != "linux", reason="fences are put up by calls of Linux")
@pytest.mark.parametrize("count", [4, pytest.param(400, marks=pytest.mark.slow)])
def test_nothing_beside_an_array_is_read_or_written(count, tmp_path):
    """Some processes have a fence behind each array, the others before it."""
    counts = fences.campaign(count, 40 if count == 4 else machinery.seed_of(), 2, tmp_path)
    assert not {name: counts[name] for name in fuzz.BAD if counts[name]}
    assert counts["accepted"] > 0.4 * count


@pytest.mark.parametrize("count", [1, pytest.param(500, marks=pytest.mark.slow)])
def test_killed_runs_go_on_or_begin_anew(count, tmp_path):
    counts = kill.campaign(count, machinery.seed_of(), PROCESSES if count > 2 else 1, tmp_path)
    if counts is None:
        pytest.skip("no C compiler, or no Linux")
    assert counts["resumed"] + counts["begun anew"] == count


@pytest.mark.parametrize("count", [6, pytest.param(600, marks=pytest.mark.slow)])
def test_damaged_files_are_told_or_harmless(count, tmp_path):
    counts = damage.campaign(count, machinery.seed_of(), 1 if count == 6 else PROCESSES, tmp_path)
    assert counts["told"] + counts["harmless"] == count


@pytest.mark.parametrize("count", [60, pytest.param(20_000, marks=pytest.mark.slow)])
def test_damaged_inputs_are_refused_with_their_names(count, tmp_path):
    counts = foreign.campaign(count, machinery.seed_of(), 1 if count == 60 else PROCESSES, tmp_path)
    assert not {name: counts[name] for name in foreign.BAD if counts[name]}
    assert counts["refused"] > 0.4 * count


@pytest.mark.slow
def test_odd_arguments_are_taken_or_named(tmp_path):
    counts = arguments.campaign(10**6, machinery.seed_of(), PROCESSES, tmp_path)
    assert not {name: counts[name] for name in arguments.BAD if counts[name]}


def test_every_public_callable_is_tried():
    """New public names must be given odd arguments, too."""
    import farhorizon as fh

    assert set(arguments.good()) | arguments.NOT_CALLED == set(fh.__all__)
