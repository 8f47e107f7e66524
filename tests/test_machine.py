"""Long computations report their progress if stderr is a terminal; the memory that a run may take."""

import os
import subprocess
import sys

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import farhorizon as fh
from farhorizon import machine
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


def test_small_linear_algebra_is_on_one_thread_and_the_other_threads_come_back():
    def threads():
        return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with machine.one_blas_thread(), machine.one_blas_thread():
            assert set(threads()) == {1}
        assert threads() == before != []


GROUPS = {
    "version 2": (
        "30 24 0:26 / {top} rw - cgroup2 cgroup2 rw\n",
        "0::/jobs/one\n",
        ("memory.max", "memory.current", "inactive_file"),
    ),
    "version 1": (
        "30 24 0:26 / {top} rw - cgroup cgroup rw,cpu,cpuacct\n31 24 0:27 / {top} rw - cgroup cgroup rw,memory\n",
        "3:cpu,cpuacct:/other\n4:memory:/jobs/one\n0::/\n",
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ),
}


@pytest.mark.parametrize("version", GROUPS)
@pytest.mark.parametrize("inside", [False, True], ids=["on the machine", "inside a container"])
def test_memory_of_control_groups(version, inside, tmp_path):
    """As the kernel shows them; a container sees its own group at the top, under a path of the machine."""
    mounts, groups, (limit, used, cached) = GROUPS[version]
    top = tmp_path / "fs"
    own = top if inside else top / "jobs" / "one"
    own.mkdir(parents=True)
    (tmp_path / "mountinfo").write_text("1 1 8:1 / / rw - ext4 /dev/sda rw\n" + mounts.format(top=top))
    (tmp_path / "cgroup").write_text(groups)
    (own / limit).write_text("1000000\n")
    (own / used).write_text("400000\n")
    (own / "memory.stat").write_text(f"anon 300000\n{cached} 50000\n")
    assert set(machine._left_by_groups(tmp_path)) == {650000}
    if not inside:  # the group around it has less
        (top / "jobs" / limit).write_text("900000\n")
        (top / "jobs" / used).write_text("800000\n")
        assert set(machine._left_by_groups(tmp_path)) == {650000, 100000}
    (own / limit).write_text({"version 2": "max\n", "version 1": f"{2**63 - 4096}\n"}[version])
    assert min(machine._left_by_groups(tmp_path), default=2**60) in (100000, 2**60) or inside
    assert not list(machine._left_by_groups(tmp_path / "nowhere"))


@pytest.mark.parametrize("given", [{"MEM_PER_NODE": "3000"}, {"MEM_PER_CPU": "1500", "CPUS_ON_NODE": "2"}])
def test_memory_that_slurm_has_granted(given, monkeypatch):
    for name, value in given.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    assert 0 < machine.available_memory() < 3000 * 2**20
    monkeypatch.setenv("SLURM_MEM_PER_NODE", "0")  # all memory
    if "MEM_PER_NODE" in given:
        assert not list(machine._granted_by_slurm())


LIMITED = """
import resource
import farhorizon as fh
from farhorizon import machine
resource.setrlimit(getattr(resource, "{kind}"), (4 * 2**30, 4 * 2**30))
print(machine.available_memory())
try:
    fh.Lattice(1.0, (0.0, 0.0), (40000.0, 40000.0)).mask
    fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (20000.0, 20000.0)), fh.Wave(fh.Kernel(1.0)), fh.Fixed())
except fh.InputError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")
@pytest.mark.parametrize("kind", ["RLIMIT_AS", "RLIMIT_DATA"])
def test_memory_under_limits_of_the_process(kind):
    """As `ulimit -v` and `-d` set them: a run that exceeds them is refused."""
    done = subprocess.run(
        [sys.executable, "-c", LIMITED.format(kind=kind)], capture_output=True, text=True, env={**os.environ}
    )
    told, refusal = done.stdout.splitlines()
    assert 0 < int(told) < 4 * 2**30
    assert "fit into memory" in refusal, done.stderr


ROOMS = {
    "grid": lambda n: fh.Receivers.grid((0.0, 0.0), (9.0, 9.0), (n, n)),
    "grid in space": lambda n: fh.Receivers.grid((0.0,) * 3, (9.0,) * 3, (n, n, n)),
    "phased array": lambda n: fh.Simulation(
        lattice_of((501, 501)),
        fh.Wave(fh.Kernel(2.0)),
        fh.LatticePML(nodes=4),
        sources=[fh.PhasedArray((3.0, 3.0), (9.0, 3.0), n, 1.0, time=fh.Ricker(0.1))],
    ),
}


@pytest.mark.parametrize("what", ROOMS)
@pytest.mark.parametrize("n", [10**5, 10**6])
def test_so_many_points_are_refused_before_memory_is_asked_for(what, n, monkeypatch):
    monkeypatch.setattr(machine, "available_memory", lambda: 2**36)
    with pytest.raises(fh.InputError, match="do not fit into memory"):
        ROOMS[what](n)
