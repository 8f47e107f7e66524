"""The number of nodes that layers need."""

from types import SimpleNamespace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.families import thin
from farhorizon.analysis.layers.thickness import NotKept, distance_to_side, keeps, least, thinnest


class Waves:
    """Waves of which a layer reflects a given function of its number of nodes, or all of them by a rough estimate."""

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
    """The closed form may be far above the actual reflection; when the last layer was judged by it, targets were
    refused that the layer would have kept.
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
    """From any starting number of nodes, the thinnest layer is found to a sixteenth if the error falls as expected,
    and to a third in any case.
    """
    waves = Waves(lambda nodes: max(fall**-nodes, floor))
    found = thinnest(one_member, [waves], 1e-5, 1.0, lambda layer: more, start=start)
    least_nodes = int(np.ceil(np.log(2.5e5) / np.log(fall)))
    known = least_nodes < 16 or (not floor and least_nodes > 0.75 * start)
    assert least_nodes <= found.nodes <= (least_nodes * 17 // 16 if known else 4 * least_nodes / 3 + 1)
    assert found.predicted == waves.error(found.nodes) + more
    before = {0: 9, 12: 3, 50: 0}[start]  # at most, to reach it from below
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
