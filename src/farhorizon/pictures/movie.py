"""Films of a field: GIF by Pillow, and MP4 by imageio-ffmpeg if that is installed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.html import film
from farhorizon.files.storage import replacing
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.panels import PLAIN, Axes, Look, Panel, Plane
from farhorizon.pictures.style import extent_beyond

_SECONDS = 8.0  # duration of a film, as far as the range of rates allows
_RATES = (5, 25)  # smallest and largest number of frames per second
_DPI = 110  # 700 pixels for a usual frame, so that a GIF has some megabytes at most
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


def made_film(frames: Sequence[Panel], axes: Axes, format: str = "gif", look: Look = PLAIN) -> Film:
    """A film of frames as in `field_panels`, on one scale, unless given up to the median of their largest values and at
    least a fifth of the largest, so that a wave that leaves remains visible; ImportError without the encoder of MP4.
    """
    if len(frames) < 2:
        raise InputError(
            "a film needs two outputs or more",
            value=len(frames),
            limit=">= 2",
            key="--movie",
            remedy="a smaller output.every, or no --times",
        )
    fields = [frame.seen for frame in frames]
    limits = look.limits or _limits(fields, cut=len(axes) > 1 and look.colors is None)
    if len(axes) == 3:
        plane = look.plane or Plane.middle([axis.size for axis in axes])
        fields = [plane.of(values) for values in fields]
    # an arrow that appears and disappears would move the picture
    look = look._replace(limits=limits, beyond=extent_beyond(fields, limits))
    rate = int(np.clip(len(frames) / _SECONDS, *_RATES))
    return Film(_ENCODERS[format]((_pixels(frame, axes, look) for frame in frames), rate), format, len(frames))


def movie(frames: Sequence[Panel], axes: Axes, path: Path, look: Look = PLAIN) -> list[Path]:
    """Write a film drawn by `made_film` to files named by a path without an ending: ``.gif``, and ``.mp4`` if
    imageio-ffmpeg is installed.
    """
    first = made_film(frames, axes, "gif", look)
    path.parent.mkdir(parents=True, exist_ok=True)
    written = [first.save(path.with_name(f"{path.name}.gif"))]
    with suppress(ImportError):
        written.append(made_film(frames, axes, "mp4", look).save(path.with_name(f"{path.name}.mp4")))
    return written


def _limits(fields: Sequence[np.ndarray], cut: bool) -> tuple[float, float]:
    """One scale for all frames; with `cut`, it may cut off values that are much larger than in most of them."""
    peaks = [float(np.nanmax(np.abs(values), initial=0.0)) for values in fields]
    top = (max(float(np.median(peaks)), _DECAYED * max(peaks)) if cut else 1.02 * max(peaks)) or 1.0
    low = min(float(np.nanmin(values, initial=np.inf)) for values in fields)
    high = max(float(np.nanmax(values, initial=-np.inf)) for values in fields)
    if low < -0.01 * top:  # less is undershoot, as in `color_range`
        return -top, top
    return (low, high) if 0 < 0.5 * high < low < high else (0.0, top)


def _pixels(frame: Panel, axes: Axes, look: Look) -> np.ndarray:
    """Pixels of one frame, shape (height, width, 3), with even height and width, as encoders require."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = field_panels([frame], axes, None, look)
    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    return np.ascontiguousarray(pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2])


def _gif(frames: Iterator[np.ndarray], rate: int) -> bytes:
    from PIL import Image

    first, *rest = [Image.fromarray(frame).convert("P", palette=Image.Palette.ADAPTIVE) for frame in frames]
    encoded = BytesIO()
    first.save(encoded, format="GIF", save_all=True, append_images=rest, duration=round(1000 / rate), loop=0)
    return encoded.getvalue()


def _mp4(frames: Iterator[np.ndarray], rate: int) -> bytes:
    """Encode an MP4; raises ImportError if imageio-ffmpeg is not installed."""
    from imageio_ffmpeg import write_frames

    first = next(frames)
    with TemporaryDirectory() as folder:
        path = Path(folder, "film.mp4")  # ffmpeg requires a file whose ending determines the format
        writer = write_frames(str(path), first.shape[1::-1], fps=rate, macro_block_size=2, quality=8)
        writer.send(None)
        writer.send(first)
        for frame in frames:
            writer.send(frame)
        writer.close()
        return path.read_bytes()


_ENCODERS = {"gif": _gif, "mp4": _mp4}


def film_format(path: Path, key: str) -> str:
    """Format of a film from the ending of its name; InputError if it is unknown or its encoder is missing."""
    ending = path.suffix.lower().lstrip(".")
    if ending not in _ENCODERS:
        raise InputError("unknown format of films", value=path.name, limit=", ".join(_ENCODERS), key=key)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", key=key, remedy="create it first")
    if ending == "mp4" and find_spec("imageio_ffmpeg") is None:
        remedy = "a .gif, or pip install 'farhorizon[movie]'"
        raise InputError("imageio-ffmpeg is not installed", value=path.name, key=key, remedy=remedy)
    return ending
