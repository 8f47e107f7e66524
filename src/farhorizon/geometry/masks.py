"""Drawn regions of the plane: text in a font, the dark parts of an image.

matplotlib, which reads the fonts and the images, is imported when such a region is created.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Length, OneOf, Point
from farhorizon.errors import InputError
from farhorizon.files.foreign import naming, reading
from farhorizon.geometry.shapes import TOLERANCE, Array, Mask, Shape, constant, polygon_side

_File = Annotated[
    Path, 'Path of an image beside the case file, such as "specimen.png" or a JPEG; its dark pixels are the region.'
]
_FONT_SIZE = 1000.0  # at which curves become polygons, accurate to one part in some thousands


class Text(Shape):
    """The letters of one line of text; its size is the longer edge of its bounding box.

    Parameters
    ----------
    text : str
        The text.
    height : float
        Height of a capital letter (of the H of the font).
    centre : array_like, shape (2,), optional
        Centre of the bounding box of the drawn text; the origin unless given.
    font : str
        Name of a font family that matplotlib can find; DejaVu Sans is included with it.
    bold : bool
        Bold letters.

    Raises
    ------
    InputError
        Nothing to draw, several lines, a letter or a font that is not available, values that are not positive or not
        finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> letter = fh.Text("I", height=4.0)
    >>> letter.contains([(0.0, 0.0), (3.0, 0.0)])
    array([ True, False])
    """

    dim = 2
    _shown = ("text", "height", "centre", "font", "bold")

    def __init__(
        self, text: str, height: Length, centre: Point | None = None, font: str = "DejaVu Sans", bold: bool = False
    ) -> None:
        from matplotlib.font_manager import FontProperties, findfont, get_font
        from matplotlib.textpath import TextPath

        self.text, self.font, self.bold = kinds.text(text, "text"), kinds.text(font, "font"), kinds.flag(bold, "bold")
        self.height = kinds.number(height, "height", above=0)
        self.centre = constant("centre", np.zeros(2) if centre is None else centre, (2,))
        look = FontProperties(family=font, weight="bold" if bold else "normal")
        try:
            characters = get_font(findfont(look, fallback_to_default=False)).get_charmap()
        except ValueError:
            raise InputError(
                "no such font", value=font, key="font", remedy="DejaVu Sans, or a family that matplotlib finds"
            ) from None
        missing = sorted({letter for letter in text if ord(letter) not in characters})
        if missing or not text.strip():
            raise InputError(
                "the font cannot draw this",
                value=text,
                limit="one line of letters of the font",
                key="text",
                remedy=f"leave out {missing}" if missing else "give a text",
            )
        capital = TextPath((0, 0), "H", size=_FONT_SIZE, prop=look).get_extents().height
        plain = text.replace("$", r"\$")  # matplotlib takes text between dollar signs for mathematics
        loops = TextPath((0, 0), plain, size=_FONT_SIZE, prop=look).to_polygons(closed_only=True)
        drawn = [np.asarray(loop, float)[:-1] * (self.height / capital) for loop in loops]
        middle = (np.min([loop.min(0) for loop in drawn], axis=0) + np.max([loop.max(0) for loop in drawn], axis=0)) / 2
        self._loops = [loop - middle + self.centre for loop in drawn]

    def bounds(self) -> tuple[Array, Array]:
        return np.min([loop.min(0) for loop in self._loops], axis=0), np.max(
            [loop.max(0) for loop in self._loops], axis=0
        )

    def _contains(self, points: Array) -> Mask:
        lower, upper = self.bounds()
        slack = TOLERANCE * (upper - lower).max()
        odd, on_edge = np.zeros(points.shape[:-1], bool), np.zeros(points.shape[:-1], bool)
        for loop in self._loops:  # a loop inside another one is a hole
            near = ((points >= loop.min(0) - slack) & (points <= loop.max(0) + slack)).all(axis=-1)
            inside, edge = polygon_side(points[near], loop, slack)
            odd[near] ^= inside
            on_edge[near] |= edge
        return odd | on_edge


class ImageMask(Shape):
    """The dark pixels of an image; its size is its width.

    Parameters
    ----------
    image : str, Path or ndarray of bool, shape (rows, columns)
        A file (PNG, JPEG), of which the pixels darker than `threshold` are used, where transparent ones count as white;
        or a mask of the pixels themselves, with the top row first.
    width : float
        Width of the whole image; pixels are square.
    centre : array_like, shape (2,), optional
        Centre of the whole image; the origin unless given.
    threshold : float
        Brightness between 0 (black) and 1 (white), of a file: darker pixels belong to the shape.

    Attributes
    ----------
    image : ndarray of bool
        The pixels that belong to the shape.

    Raises
    ------
    InputError
        A file that cannot be read, no dark pixel, a threshold out of range, values that are not positive or not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> picture = np.array([[1, 0], [1, 1]], bool)  # a step, the first row on top
    >>> fh.ImageMask(picture, width=2.0).contains([(-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)])
    array([ True, False,  True])
    """

    dim = 2
    tag = "image"
    _shown = ("width", "centre", "threshold")

    def __init__(
        self,
        image: Annotated[str | Path | np.ndarray, OneOf(file=_File)],
        width: Length,
        centre: Point | None = None,
        threshold: float = 0.5,
    ) -> None:
        self.threshold = threshold = kinds.number(threshold, "threshold", above=0, below=1)
        self.width = kinds.number(width, "width", above=0)
        self.centre = constant("centre", np.zeros(2) if centre is None else centre, (2,))
        if not isinstance(image, str | Path | np.ndarray):
            raise InputError("an image is a file or a table of bool", value=kinds.said(image), key="image")
        self.image = image if isinstance(image, np.ndarray) else _brightness(Path(image)) < threshold
        with naming(image):
            self._check()

    def _check(self) -> None:
        if self.image.ndim != 2 or self.image.dtype != bool:
            raise InputError(
                "an image is a file or a table of bool",
                value=f"{self.image.dtype}, shape {self.image.shape}",
                key="image",
            )
        if not self.image.any():
            limit = f"below {self.threshold:g}"
            raise InputError("the image has no dark pixel", limit=limit, key="image", remedy="a higher threshold")

    @property
    def _pixel(self) -> float:
        return self.width / self.image.shape[1]

    @property
    def _corner(self) -> Array:
        """Upper left corner."""
        return self.centre + np.array([-0.5, 0.5]) * self._pixel * np.array(self.image.shape[::-1])

    def bounds(self) -> tuple[Array, Array]:
        rows, columns = (np.flatnonzero(self.image.any(axis)) for axis in (1, 0))
        low, high = np.array([columns[0], -rows[-1] - 1]), np.array([columns[-1] + 1, -rows[0]])
        return self._corner + self._pixel * low, self._corner + self._pixel * high

    def _contains(self, points: Array) -> Mask:
        column, row = (
            np.floor((points - self._corner)[..., axis] * sign / self._pixel) for axis, sign in ((0, 1), (1, -1))
        )
        in_image = (column >= 0) & (column < self.image.shape[1]) & (row >= 0) & (row < self.image.shape[0])
        contained = np.zeros(points.shape[:-1], bool)
        contained[in_image] = self.image[row[in_image].astype(int), column[in_image].astype(int)]
        return contained


def _brightness(path: Path) -> Array:
    """Brightness of the pixels of an image on white, 0 to 1; raises InputError if the file cannot be read."""
    from matplotlib.image import imread

    with reading(path, "the image", "image", "a PNG or JPEG file"):
        values = np.asarray(imread(path))
    values = values / 255.0 if values.dtype.kind == "u" else values.astype(float)
    if values.ndim == 2:
        return values
    colours = values.shape[2] - (values.shape[2] + 1) % 2  # 1 or 3; a further channel is the opacity
    grey = values[..., :colours] @ ([1.0] if colours == 1 else [0.299, 0.587, 0.114])  # ITU-R BT.601
    return np.asarray(grey if colours == values.shape[2] else 1 - values[..., -1] * (1 - grey))
