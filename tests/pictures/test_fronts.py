"""Corrosion fronts."""

import numpy as np
import pytest

from drawn import axes_of, is_picture
from farhorizon.errors import InputError
from farhorizon.pictures import fronts
from farhorizon.pictures.panels import Look


@pytest.mark.parametrize("dim", [2, 3])
def test_front(tmp_path, dim):
    """Times of dissolution, remaining metal, a window and a film; a field without metal is drawn, too."""
    axes = axes_of(dim)
    radius = np.sqrt(sum(x**2 for x in np.meshgrid(*axes, indexing="ij")))
    dissolved = np.where(radius > 0.8, 0.0, np.where(radius < 0.3, np.nan, 1 - radius))
    outside = radius > 1.2
    film = [np.array([[-0.5] * dim, [0.5] * dim])]
    fronts.front(np.where(outside, np.nan, dissolved), axes, tmp_path / "a.png", Look(cracks=film), outside)
    fronts.front(np.zeros(dissolved.shape), axes, tmp_path / "b.png")
    assert is_picture(tmp_path / "a.png") and is_picture(tmp_path / "b.png")
    with pytest.raises(InputError, match="two or three axes"):
        fronts.front(dissolved, axes[:1], tmp_path / "c.png")
