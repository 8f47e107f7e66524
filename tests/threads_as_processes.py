"""Threads that exchange messages as processes do, for tests that need no compiled loop."""

import threading

import numpy as np

from farhorizon.simulation.processes.process_group import ProcessGroup


class Threads(ProcessGroup):
    """One of several processes that are threads, gathering values from each other."""

    def __init__(self, number, told, barrier):
        super().__init__()
        self.number, self.size, self._told, self._barrier = number, len(told), told, barrier
        self._all = self

    def gather(self, value):
        self._told[self.number] = value
        self._barrier.wait()
        every = list(self._told)
        self._barrier.wait()
        return every

    def send_receive(self, value, to, of):
        every = self.gather(value)
        return None if of < 0 else every[of]

    def summed(self, values):
        return np.sum(self.gather(values), axis=0)


def on_threads(count, work):
    """Return what work(team) returns on each of `count` threads; raise the exception of one that fails, without
    letting the others wait for it.
    """
    told, barrier, found, failed = [None] * count, threading.Barrier(count, timeout=60), [None] * count, []

    def run(number):
        try:
            found[number] = work(Threads(number, told, barrier))
        except threading.BrokenBarrierError:
            pass  # another thread has failed
        except Exception as error:
            failed.append(error)
            barrier.abort()

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failed:
        raise failed[0]
    return found
