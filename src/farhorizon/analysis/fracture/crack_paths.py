"""Positions of cracks: tips, branches and lengths, from the damage of nodes in the plane.

Regions that have lost enough of their bonds are thinned to lines one node wide (Guo and Hall, 1989, Commun. ACM 32,
359), whose ends are tips. A tip is where the damage along the line falls to half of the damage beside a long crack: the
bonds ahead of and behind the tip of a straight crack are mirror images of each other, so that half of them are intact
there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.optimize import linear_sum_assignment

_AROUND = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))  # in order
_SHORT = 2.0  # horizons: shorter lines from a branch to an end are part of the width of a crack
_SAMPLES = 8  # per spacing, along the direction ahead of a tip


@dataclass(frozen=True, eq=False)
class CrackPaths:
    """Cracks at one time.

    Attributes
    ----------
    tips : ndarray, shape (T, 2)
    ahead : ndarray, shape (T, 2)
        Unit vectors, the directions ahead of the tips.
    branches : ndarray, shape (B, 2)
        Positions where three or more lines meet.
    paths : list of ndarray, each of shape (n, 2)
        Lines between tips, branches and edges.
    """

    tips: np.ndarray
    ahead: np.ndarray
    branches: np.ndarray
    paths: list[np.ndarray]

    @property
    def length(self) -> float:
        """Total length of all lines."""
        return float(sum(np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in self.paths))


def find_cracks(damage: np.ndarray, lower: np.ndarray, spacing: float, threshold: float, horizon: float) -> CrackPaths:
    """Find the cracks in a field of damage.

    Parameters
    ----------
    damage : ndarray, shape (nx, ny)
        Share of the bonds of each node that are cut or broken.
    lower : ndarray, shape (2,)
        Position of the first node.
    spacing, horizon : float
        Branches shorter than two horizons count as part of the width of a crack.
    threshold : float
        Half of the damage beside a long crack.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(20.0)
    >>> damage = 0.4 * np.clip((12.25 - x) / 4 + 0.5, 0, 1)[:, None] * np.isin(np.arange(9), (4, 5))
    >>> found = find_cracks(damage, np.zeros(2), 1.0, threshold=0.2, horizon=2.0)
    >>> found.tips.tolist()  # the other end leaves through the edge
    [[12.25, 4.5]]
    """
    values, reach = np.nan_to_num(damage), max(1, round(horizon / spacing))
    thin = _pruned(_thinned(values >= threshold), int(np.ceil(_SHORT * horizon / spacing)))
    lines, degrees = _lines(thin)
    branches = _gathered(
        np.array([place for place, degree in degrees.items() if degree > 2], float).reshape(-1, 2), reach
    )
    margin, shape = horizon / spacing, np.array(values.shape)
    tips, ahead, paths = [], [], []
    for line in lines:
        smooth = _centred(values, np.array(line, float), reach)
        found = {}
        for end in (0, -1):
            place = np.array(line[end])
            if degrees[line[end]] == 1 and (place >= margin).all() and (place < shape - margin).all():
                found[end] = _tip(values, smooth if end else smooth[::-1], threshold, reach)
        tips += [tip for tip, _ in found.values()]
        ahead += [way for _, way in found.values()]
        if len(smooth) > 2 * reach:  # remove the hooks that thinning leaves next to tips
            smooth = smooth[reach if 0 in found else 0 : -reach if -1 in found else None]
        path = smooth[np.unique(np.append(np.arange(0, len(smooth), reach), len(smooth) - 1))]
        before, behind = ([found[end][0]] if end in found else [] for end in (0, -1))
        path = np.array([*before, *path, *behind])
        paths.append(lower + spacing * path)
    places, ways = (np.array(one, float).reshape(-1, 2) for one in (tips, ahead))
    return CrackPaths(lower + spacing * places, ways, lower + spacing * branches, paths)


def followed(before: np.ndarray, now: np.ndarray, farthest: float) -> np.ndarray:
    """Match tips with earlier ones.

    Parameters
    ----------
    before : ndarray, shape (S, 2)
        Last positions of earlier tips; nan where there was none yet.
    now : ndarray, shape (T, 2)
    farthest : float
        Tips farther apart than this are not the same.

    Returns
    -------
    ndarray of int, shape (T,)
        For each tip the number of the earlier one; -1 for a new one.
    """
    found = np.full(len(now), -1)
    known = np.flatnonzero(np.isfinite(before).all(1))
    apart = np.linalg.norm(before[known][:, None] - now[None], axis=-1)
    for row, column in zip(*linear_sum_assignment(np.minimum(apart, 2 * farthest)), strict=True):
        if apart[row, column] <= farthest:
            found[column] = known[row]
    return found


def saturated_damage(offsets: np.ndarray) -> float:
    """Damage beside a long crack along an axis: the share of a node's bonds that lead to one side of it."""
    return float((offsets[:, 1] < 0).mean())


def _ring(mask: np.ndarray) -> np.ndarray:
    """The eight neighbours of every place, in order, shape (8, nx, ny)."""
    padded = np.pad(mask, 1)
    n, m = mask.shape
    return np.stack([padded[1 + i : 1 + i + n, 1 + j : 1 + j + m] for i, j in _AROUND])


def _thinned(mask: np.ndarray) -> np.ndarray:
    """Lines one place wide in the middle of the regions where the mask is true."""
    found = mask.copy()
    while True:
        changed = False
        for first in (True, False):
            p = _ring(found)
            pairs = [p[0] | p[1], p[2] | p[3], p[4] | p[5], p[6] | p[7]]
            shifted = [p[7] | p[0], p[1] | p[2], p[3] | p[4], p[5] | p[6]]
            apart = sum((~p[i] & (p[i + 1] | p[i + 2 - 8])).astype(int) for i in (0, 2, 4, 6))
            count = np.minimum(sum(one.astype(int) for one in pairs), sum(one.astype(int) for one in shifted))
            kept = (p[4] | p[5] | ~p[7]) & p[6] if first else (p[0] | p[1] | ~p[3]) & p[2]
            gone = found & (apart == 1) & (count >= 2) & (count <= 3) & ~kept
            found &= ~gone
            changed |= bool(gone.any())
        if not changed:
            return found


def _neighbours(thin: np.ndarray) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """The neighbours of each place on thin lines; diagonal ones only where no place next to both connects them."""
    places = {(int(i), int(j)) for i, j in np.argwhere(thin)}
    found = {}
    for i, j in places:
        near = [(i + a, j + b) for a, b in _AROUND if (i + a, j + b) in places]
        found[i, j] = [(k, m) for k, m in near if k == i or m == j or not ((k, j) in places or (i, m) in places)]
    return found


def _lines(thin: np.ndarray) -> tuple[list[list[tuple[int, int]]], dict[tuple[int, int], int]]:
    """Lines between ends and branches, as lists of places, and the number of neighbours of each place."""
    beside = _neighbours(thin)
    degrees = {place: len(near) for place, near in beside.items()}
    lines, used = [], set()
    starts = [place for place, degree in degrees.items() if degree not in (0, 2)]
    for start in starts:
        for step in beside[start]:
            if (start, step) in used:
                continue
            line = [start, step]
            while degrees[line[-1]] == 2:
                line.append(next(one for one in beside[line[-1]] if one != line[-2]))
            used |= {(line[0], line[1]), (line[-1], line[-2])}
            lines.append(line)
    return lines, degrees


def _pruned(thin: np.ndarray, least: int) -> np.ndarray:
    """Remove short lines that lead from a branch to an end."""
    found = thin.copy()
    while True:
        lines, degrees = _lines(found)
        short = [
            line
            for line in lines
            if len(line) <= least and {degrees[line[0]] == 1, degrees[line[-1]] == 1} == {True, False}
        ]
        if not short:
            return found
        line = min(short, key=len)
        gone = line[:-1] if degrees[line[0]] == 1 else line[1:]
        found[tuple(np.array(gone).T)] = False


def _gathered(places: np.ndarray, reach: int) -> np.ndarray:
    """Means of groups of places, each of which has another member of the group within reach."""
    groups: list[list[np.ndarray]] = []
    for place in places:
        near = [group for group in groups if any(np.abs(place - one).max() <= reach for one in group)]
        merged = [one for group in near for one in group] + [place]
        groups = [group for group in groups if not any(group is other for other in near)] + [merged]
    return np.array([np.mean(group, axis=0) for group in groups]).reshape(-1, 2)


def _centred(values: np.ndarray, line: np.ndarray, reach: int) -> np.ndarray:
    """A line, moved to the middle of the damage around it."""
    at = line.astype(int)
    n = 2 * reach + 1
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    steps = steps[(steps**2).sum(1) <= (n / 2) ** 2]
    around = at[:, None] + steps
    inside = ((around >= 0) & (around < values.shape)).all(-1)
    around = np.clip(around, 0, np.array(values.shape) - 1)
    weight = np.where(inside, values[tuple(around.reshape(-1, 2).T)].reshape(inside.shape), 0.0) ** 2
    middle = (weight[..., None] * around).sum(1) / weight.sum(1)[:, None]
    along = np.gradient(line, axis=0) if len(line) > 1 else np.zeros_like(line)
    along = ndimage.uniform_filter1d(along, n, axis=0, mode="nearest")
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    shift = middle - line
    return np.asarray(line + shift - (shift * along).sum(1)[:, None] * along)


def _tip(values: np.ndarray, line: np.ndarray, threshold: float, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """The tip beyond the last place of a line, and the direction ahead: that of a straight line through the places
    before the last horizon, in which thinning leaves hooks.
    """
    used = line[max(0, len(line) - 3 * reach - 1) : max(2, len(line) - reach)]
    middle = used.mean(0)
    way = np.linalg.svd(used - middle)[2][0]
    way = way * (1.0 if way @ (line[-1] - line[0]) >= 0 else -1.0)
    start = middle + way * (way @ (used[-1] - middle))
    s = np.arange(0, 4 * _SAMPLES * reach + 1) / _SAMPLES
    course = ndimage.map_coordinates(values, (start + s[:, None] * way).T, order=1, mode="nearest")
    below = np.flatnonzero(course < threshold)
    if not below.size or not below[0]:
        return line[-1], way
    i = below[0] - 1
    part = (course[i] - threshold) / (course[i] - course[i + 1])
    return start + (s[i] + part / _SAMPLES) * way, way
