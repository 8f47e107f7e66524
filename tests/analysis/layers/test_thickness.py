"""How many nodes layers take."""

from types import SimpleNamespace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.families import thin
from farhorizon.analysis.layers.thickness import NotKept, distance_to_side, keeps, least, thinnest


class Waves:
    """Of which a layer of so many nodes sends back what a function says, by a rough look all."""

    medium = SimpleNamespace(stencil=fh.Stencil.finite_difference(2))
    largest = 1.0

    def __init__(self, error, rough=False):
        self.error, self.rough, self.tried = error, rough, []

    def share(self, layer):
        return 1.0

    def returned(self, layer, enough=np.inf, closely=False):
        self.tried.append(layer.columns)
        return 1.0 if self.rough and enough < np.inf and not closely else self.error(layer.columns)

    def strongest(self, layer):
        return 1.0, ""


def one_member(nodes):
    return {"thin": thin(nodes, 4.0, 1.0)}


@pytest.mark.parametrize("exact", [1e-8, 0.9e-5, 1e-4])
def test_what_a_refusal_names_is_more_than_was_asked(exact):
    """The closed form of waves may be far above what comes back; as long as the last layer was judged by it, targets
    were refused that it keeps.
    """
    waves = [Waves(lambda nodes: exact, rough=True)]
    limit = least(one_member, waves, 1.0)
    if limit <= 1e-5:
        assert thinnest(one_member, waves, 1e-5, 1.0).nodes == 60
    else:
        with pytest.raises(NotKept) as refused:
            thinnest(one_member, waves, 1e-5, 1.0)
        assert refused.value.least >= limit > 1e-5
    assert keeps(one_member, waves, 1.001 * limit, 1.0)
    assert not keeps(one_member, waves, 0.999 * limit, 1.0)


@pytest.mark.parametrize("fall", [3.0, 1.6, 1.25])
@pytest.mark.parametrize("start", [0, 12, 50])
@pytest.mark.parametrize("floor", [0.0, 1e-6, 3.9e-6])
@pytest.mark.parametrize("more", [0.0, 5.9e-6])
def test_few_layers_are_judged_to_find_the_thinnest(fall, start, floor, more):
    """From any number of nodes, of thick layers to a sixteenth if the error falls as it should, to a third in any
    case.
    """
    waves = Waves(lambda nodes: max(fall**-nodes, floor))
    found = thinnest(one_member, [waves], 1e-5, 1.0, lambda layer: more, start=start)
    least_nodes = int(np.ceil(np.log(2.5e5) / np.log(fall)))
    known = least_nodes < 16 or (not floor and least_nodes > 0.75 * start)
    assert least_nodes <= found.nodes <= (least_nodes * 17 // 16 if known else 4 * least_nodes / 3 + 1)
    assert found.predicted == waves.error(found.nodes) + more
    before = {0: 9, 12: 3, 50: 0}[start]  # by which it is reached from below, at most
    assert len(waves.tried) - before <= (9 if floor else 5)
    assert len(set(waves.tried)) == len(waves.tried)


def test_an_error_that_is_no_number_is_too_large():
    waves = Waves(lambda nodes: np.nan if nodes < 12 else 3.0**-nodes)
    assert thinnest(one_member, [waves], 1e-5, 1.0).nodes == 12


def test_layers_known_to_be_too_thin_are_not_judged():
    waves = Waves(lambda nodes: 2.0**-nodes)
    assert thinnest(one_member, [waves], 1e-5, 1.0, too_few=17, start=18).nodes == 18
    assert waves.tried == [18]


def test_distance_of_data():
    values = np.zeros((30, 5))
    values[10, 2], values[12, 1] = 1.0, 1e-5
    assert distance_to_side([values, np.zeros((30, 5))]) == 19
    assert distance_to_side([np.zeros((30, 5))]) == 0
