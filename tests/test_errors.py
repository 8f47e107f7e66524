"""Errors that name the value, the limit and a remedy."""

import pytest

from farhorizon.analysis.layers.thickness import NotKept
from farhorizon.errors import InputError


def _kinds(kind: type) -> list[type]:
    return [kind, *(each for below in kind.__subclasses__() for each in _kinds(below))]


@pytest.mark.parametrize("kind", _kinds(InputError), ids=lambda kind: kind.__name__)
def test_every_refusal_can_be_told_anew(kind):
    """Case files put their name before a message, and their parts the key."""
    told = kind("is wrong", value=1, limit=2, remedy="another", key="one").at("two")
    assert type(told) is kind and str(told) == "two: is wrong; value: 1; limit: 2; remedy: another"
    assert str(kind(f"file: {told}")).startswith("file: two")


def test_the_refusal_of_a_target_knows_the_least_that_is_kept():
    refusal = NotKept.of(1e-6, 3e-4)
    assert refusal.least == pytest.approx(3e-4) and refusal.limit == ">= 0.0003" and refusal.value == 1e-6


@pytest.mark.parametrize(("least", "named"), [(1.25e-6, 2e-6), (1e-6, 1e-6), (9.1e-5, 1e-4), (3e-4, 3e-4)])
def test_the_least_that_is_kept_is_rounded_up(least, named):
    """Rounded to one digit, a limit of 1.25e-6 would be reported as the 1e-6 that was refused."""
    assert NotKept.of(1e-6, least).least == pytest.approx(named, rel=1e-12)
    assert float(NotKept.of(1e-6, least).limit.removeprefix(">= ")) == pytest.approx(named, rel=1e-12)
