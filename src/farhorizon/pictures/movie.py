"""Films of a field: GIF by Pillow, and MP4 by imageio-ffmpeg if that is installed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.html import film
from farhorizon.files.storage import replacing
from farhorizon.pictures.fields import field_panels, shown_plane
from farhorizon.pictures.images import unhidden
from farhorizon.pictures.style import extent_beyond

_SECONDS = 8.0  # duration of a film, as far as the range of rates allows
_RATES = (5, 25)  # smallest and largest number of frames per second
_DPI = 110
_DECAYED = 0.2  # of the largest value of all: the scale reaches at least that far even if most frames are fainter


@dataclass(frozen=True, repr=False)
class Film:
    """A film, which notebooks display.

    Attributes
    ----------
    data : bytes
        Contents of the file.
    format : {"gif", "mp4"}
    frames : int
    """

    data: bytes
    format: str
    frames: int

    def __repr__(self) -> str:
        return f"<film of {self.frames} frames, {self.format}, {len(self.data) / 1e6:.2g} MB>"

    def _repr_html_(self) -> str:
        return film(self.data, self.format)

    def save(self, path: Path) -> Path:
        """Write the file, replacing an existing one."""
        with replacing(path) as draft:
            draft.write_bytes(self.data)
        return path


def made_film(
    frames: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    kind: str = "gif",
    *,
    label: str = "u",
    limits: tuple[float, float] | None = None,
    cracks: Sequence[np.ndarray] = (),
    colors: str | None = None,
    plane: tuple[int, int] | None = None,
    title: str = "",
    broken: Sequence[np.ndarray] = (),
) -> Film:
    """Draw a film with frames as in `field_panels`, all on the same scale.

    Unless limits are given, the scale of images reaches up to the median of the largest values of the frames, and at
    least to a fifth of the largest of all, so that a wave that leaves remains visible to the end.

    Parameters
    ----------
    frames : sequence of (title, ndarray)
        Fields of the lattice shape.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis.
    kind : {"gif", "mp4"}
    label, limits, cracks, colors, plane, title, broken
        As in `field_panels`.

    Raises
    ------
    InputError
        There are fewer than two frames.
    ImportError
        An MP4 is requested, and imageio-ffmpeg is not installed.
    """
    if len(frames) < 2:
        raise InputError(
            "a film needs two outputs or more",
            value=len(frames),
            limit=">= 2",
            key="--movie",
            remedy="a smaller output.every, or no --times",
        )
    seen = [unhidden(values, broken[k] if broken else None) for k, (_, values) in enumerate(frames)]
    limits = limits or _limits(seen, cut=len(axes) > 1 and colors is None)
    rate = int(np.clip(len(frames) / _SECONDS, *_RATES))
    look: dict[str, Any] = {"label": label, "limits": limits, "cracks": cracks, "colors": colors, "plane": plane}
    if len(axes) == 3:
        normal, index = shown_plane([axis.size for axis in axes], plane)
        seen = [values.take(index, normal) for values in seen]
    look["beyond"] = extent_beyond(seen, limits)  # an arrow that appears and disappears would move the picture
    drawn = (
        _pixels(name, values, axes, **look, title=title, broken=broken[k : k + 1])
        for k, (name, values) in enumerate(frames)
    )
    return Film(_MAKERS[kind](drawn, rate), kind, len(frames))


def movie(frames: Sequence[tuple[str, np.ndarray]], axes: Sequence[np.ndarray], path: Path, **look: Any) -> list[Path]:
    """Write a film drawn by `made_film` to files: ``.gif``, and ``.mp4`` if imageio-ffmpeg is installed.

    Parameters
    ----------
    frames, axes, look
        As in `made_film`.
    path : Path
        Path without an ending; those of the formats are appended. Its folder is created.

    Raises
    ------
    InputError
        There are fewer than two frames.
    """
    first = made_film(frames, axes, "gif", **look)
    path.parent.mkdir(parents=True, exist_ok=True)
    written = [first.save(path.with_name(f"{path.name}.gif"))]
    with suppress(ImportError):
        written.append(made_film(frames, axes, "mp4", **look).save(path.with_name(f"{path.name}.mp4")))
    return written


def _limits(values: Sequence[np.ndarray], cut: bool) -> tuple[float, float]:
    """One scale for all frames; with `cut`, it may cut off values that are much larger than in most of them."""
    peaks = [float(np.nanmax(np.abs(one), initial=0.0)) for one in values]
    top = (max(float(np.median(peaks)), _DECAYED * max(peaks)) if cut else 1.02 * max(peaks)) or 1.0
    low = min(float(np.nanmin(one, initial=np.inf)) for one in values)
    high = max(float(np.nanmax(one, initial=-np.inf)) for one in values)
    if low < -0.01 * top:
        return -top, top
    return (low, high) if 0 < 0.5 * high < low < high else (0.0, top)


def _pixels(name: str, values: np.ndarray, axes: Sequence[np.ndarray], **look: Any) -> np.ndarray:
    """Pixels of one frame, shape (height, width, 3), with even height and width, as encoders require."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = field_panels([(name, values)], axes, None, **look)
    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    return np.ascontiguousarray(pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2])


def _gif(frames: Iterator[np.ndarray], rate: int) -> bytes:
    from PIL import Image

    first, *rest = [Image.fromarray(frame).convert("P", palette=Image.Palette.ADAPTIVE) for frame in frames]
    made = BytesIO()
    first.save(made, format="GIF", save_all=True, append_images=rest, duration=round(1000 / rate), loop=0)
    return made.getvalue()


def _mp4(frames: Iterator[np.ndarray], rate: int) -> bytes:
    """Encode an MP4; raises ImportError if imageio-ffmpeg is not installed."""
    from imageio_ffmpeg import write_frames

    first = next(frames)
    with TemporaryDirectory() as folder:
        path = Path(folder, "film.mp4")  # ffmpeg requires a file whose ending determines the format
        film = write_frames(str(path), first.shape[1::-1], fps=rate, macro_block_size=2, quality=8)
        film.send(None)
        film.send(first)
        for frame in frames:
            film.send(frame)
        film.close()
        return path.read_bytes()


_MAKERS = {"gif": _gif, "mp4": _mp4}


def film_format(path: Path, key: str) -> str:
    """Format of a film from the ending of its name; InputError if it is unknown or its encoder is missing."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in _MAKERS:
        raise InputError("unknown format of films", value=path.name, limit=", ".join(_MAKERS), key=key)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", key=key, remedy="create it first")
    if kind == "mp4" and find_spec("imageio_ffmpeg") is None:
        raise InputError(
            "imageio-ffmpeg is not installed",
            value=path.name,
            key=key,
            remedy="a .gif, or pip install 'farhorizon[movie]'",
        )
    return kind
