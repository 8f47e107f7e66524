"""The search for the thinnest layer, with errors that are given functions of the number of nodes."""

import numpy as np
import pytest

from farhorizon.analysis.layers.families import Family, thin
from farhorizon.analysis.layers.thickness import MOST, NotKept, Thickness, thicker, thinner, thinnest


class Errors:
    """Trials in which layers of a family have an error by their number of nodes; the difference of two is the sum."""

    def __init__(self, of_nodes, most=1000):
        self.of_nodes, self.left, self.made = of_nodes, most, []

    def _affords(self, family, nodes):
        self.left -= 1
        self.made.append((family.name, nodes))
        return self.left >= 0

    def reference(self, family, nodes):
        self.better = self.of_nodes(family.name, nodes)
        return self._affords(family, nodes)

    def error(self, family, nodes, enough):
        if not self._affords(family, nodes):
            return np.inf
        return min(self.of_nodes(family.name, nodes) + self.better, 1.1 * enough)


def family(name="thin", least=1, most=1000):
    return Family(name, lambda nodes: thin(nodes, 1.0) if least <= nodes <= most else None)


def test_a_reference_has_a_third_more_nodes():
    assert [thinner(n) for n in (2, 3, 4, 8, 20, 80)] == [1, 2, 3, 6, 15, 60]
    assert all(thinner(thicker(n)) >= n > thinner(thicker(n) - 1) for n in range(2, 100))


@pytest.mark.parametrize("fall", [5.0, 3.0, 1.6, 1.25])
@pytest.mark.parametrize("start", [3, 9, 20, 40])
def test_the_thinnest_layer_is_found_with_few_trials(fall, start):
    """To an eighth of its nodes, whatever the first reference is."""
    trials = Errors(lambda name, nodes: fall**-nodes)
    found = thinnest([family()], trials, 1e-5, start)
    least = int(np.ceil(np.log(1e5) / np.log(fall)))
    assert found.kept and found.error <= 1e-5
    assert least <= found.nodes <= max(least + 1, 9 * least / 8 + 1)
    assert len(trials.made) <= 14


def test_the_first_family_that_serves_is_taken_even_if_another_is_better_with_more_nodes():
    falls = {"tuned": 6.0, "steep": 2.0}
    families = [family("tuned", 3, 8), family("steep")]
    found = thinnest(families, Errors(lambda name, nodes: falls[name] ** -nodes), 1e-5, 12)
    assert (found.family.name, found.nodes) == ("tuned", 7)
    found = thinnest(families, Errors(lambda name, nodes: falls[name] ** -nodes), 1e-7, 12)
    assert found.family.name == "steep" and 24 <= found.nodes <= 27


def test_nothing_is_accepted_whose_reference_is_worse_than_it_should_be():
    """Layers of nine nodes and more of this family have a floor above the aim."""
    trials = Errors(lambda name, nodes: max(3.0**-nodes, 2e-5 if nodes < 40 else 1e-9))
    found = thinnest([family()], trials, 1e-5, 12)
    assert found.kept and found.nodes >= 40


def test_what_no_layer_keeps_names_the_smallest_error_of_up_to_sixty_nodes():
    trials = Errors(lambda name, nodes: 1e-3 / nodes)
    found = thinnest([family()], trials, 1e-6, 8)
    assert not found.kept and found.nodes == MOST and ("thin", thicker(MOST)) in trials.made
    assert found.error == pytest.approx(1e-3 / 60 + 1e-3 / 80)
    refusal = NotKept.of(1e-6, found.error)
    assert refusal.least == pytest.approx(3e-5) and "Auto or Extended" in str(refusal)


@pytest.mark.parametrize("most", range(1, 7))
def test_a_search_without_time_says_that_it_does_not_know(most):
    """After a reference and a candidate it takes as many nodes as their difference suggests."""
    trials = Errors(lambda name, nodes: 2.0**-nodes, most)
    found = thinnest([family()], trials, 1e-6, 9)
    assert found.kept or np.isnan(found.error)
    assert found.nodes >= (7 if most < 2 else 12) and len(trials.made) <= most + 1


@pytest.mark.parametrize("most", range(1, 12))
def test_an_error_is_told_or_unknown_whenever_time_ends(most):
    """Also where no layer keeps the aim: a refusal names an error that was found."""
    found = thinnest([family(), family("steep")], Errors(lambda name, nodes: 1e-3 / nodes, most), 1e-6, 8)
    assert not found.kept and (np.isnan(found.error) or 1e-5 < found.error < 1e-3)


def test_a_layer_tells_its_trial():
    layer = thin(6, 1.0)
    told = str(Thickness("thin (4)", layer, 3e-6, 100.0, 40.0))
    assert told == "thin (4) profile, error in trial runs 3e-06 of the largest value up to t = 40"
    assert str(Thickness("steep", layer, np.nan)) == "steep profile, without a trial run"
    assert repr(Thickness("steep", layer, np.nan)).startswith("Thickness(6 nodes, ")
