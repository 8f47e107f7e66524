"""Common parts of the fuzzers, killers and damagers: seeds, workers that may crash or hang, and comparison of
results.
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
import traceback
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
MOST_JOBS = 500  # per worker: compiled code stays in memory


def seed_of(given=None):
    """Return the given seed, that of FARHORIZON_SEED, or one from the clock, and print it, so that it can be
    repeated.
    """
    found = int(given if given is not None else os.environ.get("FARHORIZON_SEED", time.time_ns() % 10**6))
    print(f"seed {found} (FARHORIZON_SEED={found} gives the same again)", flush=True)
    return found


def random_of(*numbers):
    """Return a generator for each case: case 17 of a seed does not depend on the cases before it."""
    return np.random.default_rng(numbers)


def place(error):
    """Return where in the package an error was raised."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "farhorizon" in f.filename]
    where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    return f"{type(error).__name__} at {where}: {str(error)[:150]}"


class Worker:
    """A child process that answers jobs, as one JSON line each; its stderr is kept in case it dies."""

    def __init__(self, script, errors):
        self.errors = open(errors, "w+")
        self.process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", str(script), "--worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
        )
        self.job, self.since, self.before, self.given = None, 0.0, 0.0, 0

    def give(self, job):
        self.given += 1
        self.job, self.since, self.before = job, time.monotonic(), self.processor_time()
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()

    def processor_time(self):
        """Return the seconds of processor time so far; 0 if the operating system does not provide them."""
        try:
            fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def hangs(self, limit):
        """Return whether its job has exceeded the limit of processor time, or ten times as much real time, as others
        may be at work.
        """
        return self.processor_time() - self.before > limit or time.monotonic() - self.since > 10 * limit

    def end(self):
        """Kill the process and return its exit code and its last output."""
        self.process.kill()
        code = self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()
        self.errors.seek(0)
        said = self.errors.read()[-3000:]
        self.errors.close()
        return code, said


def answers(script, jobs: Iterable[dict], processes: int, limit: float, folder: Path) -> Iterator[dict]:
    """Yield the answers of workers to jobs as they arrive, and an answer in place of a worker that died or exceeded
    the limit.

    Parameters
    ----------
    script : Path
        Answers jobs with `serve` when it is run with --worker.
    jobs : iterable of dict
    processes : int
    limit : float
        Seconds of processor time for a job; then it hangs.
    folder : Path
        For what workers say on stderr.
    """
    waiting, workers, number = deque(jobs), [], 0
    selector = selectors.DefaultSelector()

    def start():
        nonlocal number
        number += 1
        worker = Worker(script, folder / f"worker-{number}.txt")
        selector.register(worker.process.stdout, selectors.EVENT_READ, worker)
        workers.append(worker)
        return worker

    def drop(worker):
        selector.unregister(worker.process.stdout)
        workers.remove(worker)
        return worker.end()

    for _ in range(min(processes, len(waiting))):
        start().give(waiting.popleft())
    while workers:
        for key, _ in selector.select(timeout=1.0):
            worker = key.data
            line = worker.process.stdout.readline()
            if line:
                yield worker.job | json.loads(line)
            else:
                job, code = worker.job, worker.process.wait()
                yield job | {"class": "crash", "where": f"exit code {code}", "said": drop(worker)[1]}
                worker = start() if waiting else None
            if worker is not None and waiting:
                if worker.given == MOST_JOBS:
                    drop(worker)
                    worker = start()
                worker.give(waiting.popleft())
            elif worker is not None:
                drop(worker)
        for worker in [w for w in workers if w.hangs(limit)]:
            job = worker.job
            yield job | {"class": "hang", "where": f"more than {limit:g} s", "said": drop(worker)[1]}
            if waiting:
                start().give(waiting.popleft())


def serve(answer):
    """Answer the jobs on stdin until it ends."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # the output of a case is not an answer
    for line in sys.stdin:
        out.write(json.dumps(answer(json.loads(line))) + "\n")
        out.flush()


def table(found: Iterable[dict], bad: Iterable[str], folder: Path, report=print) -> Counter:
    """Count answers by class and keep bad ones in a folder, one file each; each bad place is reported once."""
    counts: Counter = Counter()
    places: Counter = Counter()
    for number, answer in enumerate(found, 1):
        counts[answer["class"]] += 1
        if number % 500 == 0:
            report(f"{number} so far", flush=True)
        if answer["class"] in bad:
            place = f"{answer['class']}: {answer.get('where', '')}"
            places[place] += 1
            name = f"{answer['class']}-{answer['seed']}-{answer['number']}.json"
            (folder / name).write_text(json.dumps(answer, indent=1))
            if places[place] == 1:
                report(f"{place} ({folder / name})", flush=True)
    report(", ".join(f"{name} {count}" for name, count in counts.most_common()))
    return counts


def same_results(one: Path, other: Path):
    """Assert that two results files are bitwise equal, except for the provenance."""
    import h5py

    from farhorizon.files.results import open_results

    assert open_results(one).finished and open_results(other).finished
    with h5py.File(one) as mine, h5py.File(other) as theirs:
        names = [sorted(_datasets(file)) for file in (mine, theirs)]
        assert names[0] == names[1], set(names[0]) ^ set(names[1])
        for name in names[0]:
            assert mine[name].shape == theirs[name].shape, name
            assert np.asarray(mine[name]).tobytes() == np.asarray(theirs[name]).tobytes(), name


def _datasets(file):
    """Return the names of all data sets of numbers in a file."""
    found = []

    def look(name, item):
        if getattr(item, "dtype", np.dtype("O")).kind in "biuf":
            found.append(name)

    file.visititems(look)
    return found
