import threading

import pytest

from farhorizon.engine.engine import at_most, available_threads
from farhorizon.engine.parallel import in_parallel


def test_results_come_in_the_order_of_the_parts_and_from_as_many_threads_as_are_allowed():
    together = threading.Barrier(min(2, available_threads()))

    def square(number):
        together.wait(30)  # none returns before the other has begun
        return number**2, threading.get_ident()

    results = in_parallel(square, [3, 2])
    assert [value for value, _ in results] == [9, 4]
    assert len({thread for _, thread in results}) == min(2, available_threads())
    with at_most(1):
        assert in_parallel(lambda part: threading.get_ident(), [1, 2, 3]) == [threading.get_ident()] * 3


def test_an_error_in_a_part_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_parallel(lambda number: 1 / number, [1, 0, 2])
