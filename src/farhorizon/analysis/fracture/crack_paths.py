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

from farhorizon.rounding import TINY

_AROUND = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))  # in order
_SHORT = 2.0  # horizons: shorter lines from a branch to an end are part of the width of a crack
_SAMPLES = 8  # per spacing, along the direction ahead of a tip


@dataclass(frozen=True, eq=False)
class CrackPaths:
    """Cracks at one time."""

    tips: np.ndarray  # (T, 2)
    ahead: np.ndarray  # unit vectors, the directions ahead of the tips, (T, 2)
    branches: np.ndarray  # positions where three or more lines meet, (B, 2)
    paths: list[np.ndarray]  # lines between tips, branches and edges, each of shape (n, 2)

    @property
    def length(self) -> float:
        """Total length of all lines."""
        return float(sum(np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in self.paths))


def find_cracks(damage: np.ndarray, lower: np.ndarray, spacing: float, threshold: float, horizon: float) -> CrackPaths:
    """Find the cracks in a field of damage, the fraction of the bonds of each node that are cut or broken, (nx, ny);
    `lower` is the position of the first node, `threshold` half of the damage beside a long crack. Branches shorter than
    two horizons count as part of the width of a crack.
    """
    values, reach = np.nan_to_num(damage), max(1, round(horizon / spacing))
    lines_mask = _pruned(_thinned(values >= threshold), int(np.ceil(_SHORT * horizon / spacing)))
    lines, degrees = _lines(lines_mask)
    branches = _gathered(
        np.array([place for place, degree in degrees.items() if degree > 2], float).reshape(-1, 2), reach
    )
    margin, shape = horizon / spacing, np.array(values.shape)
    tips, ahead, paths = [], [], []
    for line in lines:
        smooth = _centred(values, np.array(line, float), reach)
        tip_at = {}
        for end in (0, -1):
            place = np.array(line[end])
            if degrees[line[end]] == 1 and (place >= margin).all() and (place < shape - margin).all():
                tip_at[end] = _tip(values, smooth if end else smooth[::-1], threshold, reach)
        tips += [tip for tip, _ in tip_at.values()]
        ahead += [way for _, way in tip_at.values()]
        if len(smooth) > 2 * reach:  # remove the hooks that thinning leaves next to tips
            smooth = smooth[reach if 0 in tip_at else 0 : -reach if -1 in tip_at else None]
        path = smooth[np.unique(np.append(np.arange(0, len(smooth), reach), len(smooth) - 1))]
        before, behind = ([tip_at[end][0]] if end in tip_at else [] for end in (0, -1))
        path = np.array([*before, *path, *behind])
        paths.append(lower + spacing * path)
    places, ways = (np.array(positions, float).reshape(-1, 2) for positions in (tips, ahead))
    return CrackPaths(lower + spacing * places, ways, lower + spacing * branches, paths)


def followed(before: np.ndarray, now: np.ndarray, farthest: float) -> np.ndarray:
    """For each tip (T, 2) the number of the earlier one (S, 2) that it was, -1 for a new one: tips farther apart than
    `farthest` are not the same. Last positions of earlier tips are nan where there was none yet.
    """
    numbers = np.full(len(now), -1)
    known = np.flatnonzero(np.isfinite(before).all(1))
    apart = np.linalg.norm(before[known][:, None] - now[None], axis=-1)
    for row, column in zip(*linear_sum_assignment(np.minimum(apart, 2 * farthest)), strict=True):
        if apart[row, column] <= farthest:
            numbers[column] = known[row]
    return numbers


def saturated_damage(offsets: np.ndarray) -> float:
    """Damage beside a long crack along an axis: the fraction of a node's bonds that lead to one side of it."""
    return float((offsets[:, 1] < 0).mean())


def _ring(mask: np.ndarray) -> np.ndarray:
    """The eight neighbours of every place, in order, shape (8, nx, ny)."""
    padded = np.pad(mask, 1)
    n, m = mask.shape
    return np.stack([padded[1 + i : 1 + i + n, 1 + j : 1 + j + m] for i, j in _AROUND])


def _thinned(mask: np.ndarray) -> np.ndarray:
    """Lines one place wide in the middle of the regions where the mask is true."""
    lines = mask.copy()
    while True:
        changed = False
        for first in (True, False):
            p = _ring(lines)
            pairs = [p[0] | p[1], p[2] | p[3], p[4] | p[5], p[6] | p[7]]
            shifted = [p[7] | p[0], p[1] | p[2], p[3] | p[4], p[5] | p[6]]
            apart = sum((~p[i] & (p[i + 1] | p[i + 2 - 8])).astype(int) for i in (0, 2, 4, 6))
            count = np.minimum(sum(pair.astype(int) for pair in pairs), sum(pair.astype(int) for pair in shifted))
            needed = (p[4] | p[5] | ~p[7]) & p[6] if first else (p[0] | p[1] | ~p[3]) & p[2]
            removed = lines & (apart == 1) & (count >= 2) & (count <= 3) & ~needed
            lines &= ~removed
            changed |= bool(removed.any())
        if not changed:
            return lines


def _neighbours(thin: np.ndarray) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """The neighbours of each place on thin lines; diagonal ones only where no place next to both connects them."""
    places = {(int(i), int(j)) for i, j in np.argwhere(thin)}
    neighbours = {}
    for i, j in places:
        near = [(i + a, j + b) for a, b in _AROUND if (i + a, j + b) in places]
        neighbours[i, j] = [(k, m) for k, m in near if k == i or m == j or not ((k, j) in places or (i, m) in places)]
    return neighbours


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
                line.append(next(place for place in beside[line[-1]] if place != line[-2]))
            used |= {(line[0], line[1]), (line[-1], line[-2])}
            lines.append(line)
    return lines, degrees


def _pruned(thin: np.ndarray, least: int) -> np.ndarray:
    """Remove short lines that lead from a branch to an end."""
    lines_mask = thin.copy()
    while True:
        lines, degrees = _lines(lines_mask)
        short = [
            line
            for line in lines
            if len(line) <= least and {degrees[line[0]] == 1, degrees[line[-1]] == 1} == {True, False}
        ]
        if not short:
            return lines_mask
        line = min(short, key=len)
        removed = line[:-1] if degrees[line[0]] == 1 else line[1:]
        lines_mask[tuple(np.array(removed).T)] = False


def _gathered(places: np.ndarray, reach: int) -> np.ndarray:
    """Means of groups of places, each of which has another member of the group within reach."""
    groups: list[list[np.ndarray]] = []
    for place in places:
        near = [group for group in groups if any(np.abs(place - member).max() <= reach for member in group)]
        merged = [member for group in near for member in group] + [place]
        groups = [group for group in groups if not any(group is merged_group for merged_group in near)] + [merged]
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
    along /= np.maximum(np.linalg.norm(along, axis=1), TINY)[:, None]
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
