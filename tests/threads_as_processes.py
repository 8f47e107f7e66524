"""Threads that exchange messages as processes do, for tests that need no compiled loop."""

import threading

import numpy as np

from farhorizon.simulation.processes.process_group import ProcessGroup


class Threads(ProcessGroup):
    """One of several processes that are threads, gathering values from each other."""

    def __init__(self, number, shared, barrier):
        super().__init__()
        self.number, self.size, self._shared, self._barrier = number, len(shared), shared, barrier
        self._communicator = self

    def gather(self, value):
        self._shared[self.number] = value
        self._barrier.wait()
        values = list(self._shared)
        self._barrier.wait()
        return values

    def _shifted(self, value, to, of):
        values = self.gather(value)
        return None if of < 0 else values[of]

    def summed(self, values):
        return np.sum(self.gather(values), axis=0)


def on_threads(count, work):
    """Return what work(group) returns on each of `count` threads; raise the exception of one that fails, without
    letting the others wait for it.
    """
    shared, barrier, results, failures = [None] * count, threading.Barrier(count, timeout=60), [None] * count, []

    def run(number):
        try:
            results[number] = work(Threads(number, shared, barrier))
        except threading.BrokenBarrierError:
            pass  # another thread has failed
        except Exception as error:
            failures.append(error)
            barrier.abort()

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]
    return results
