"""Films of a field: a GIF by Pillow, an MP4 by imageio-ffmpeg where that is installed."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import field_panels

_SECONDS = 8.0  # of a film; between the two rates
_RATES = (5, 25)  # frames a second
_DPI = 110
_DECAYED = 0.2  # of the largest value of all: what is more is cut off where most frames are fainter


def movie(
    frames: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: Path,
    *,
    label: str = "u",
    limits: tuple[float, float] | None = None,
    cracks: Sequence[np.ndarray] = (),
    colors: str | None = None,
    plane: tuple[int, int] | None = None,
) -> list[Path]:
    """Draw a film, each frame as `field_panels` draws it, on one scale.

    Unless limits are given, the scale of images reaches as far as the median of the largest values of the frames, or a
    fifth of the largest of all: a wave that leaves is seen to its end.

    Parameters
    ----------
    frames : sequence of (title, ndarray)
        Fields of the lattice shape.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis.
    path : Path
        Without an ending; those of the formats are added. Its folder is made.
    label, limits, cracks, colors, plane
        As of `field_panels`.

    Returns
    -------
    list of Path
        The files: ``.gif``, and ``.mp4`` if imageio-ffmpeg is installed.

    Raises
    ------
    InputError
        There is one frame, or none.
    """
    if len(frames) < 2:
        raise InputError(
            "a film needs two outputs or more",
            value=len(frames),
            limit=">= 2",
            key="--movie",
            remedy="a smaller output.every, or no --times",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    limits = limits or _limits([values for _, values in frames], cut=len(axes) > 1 and colors is None)
    rate = int(np.clip(len(frames) / _SECONDS, *_RATES))

    def drawn() -> Iterator[np.ndarray]:
        for title, values in frames:
            yield _pixels(title, values, axes, label=label, limits=limits, cracks=cracks, colors=colors, plane=plane)

    written = [_gif(path.with_name(f"{path.name}.gif"), drawn(), rate)]
    with suppress(ImportError):
        written.append(_mp4(path.with_name(f"{path.name}.mp4"), drawn(), rate))
    return written


def _limits(values: Sequence[np.ndarray], cut: bool) -> tuple[float, float]:
    """One scale for all frames; it may `cut` off what is much more than most of them have."""
    peaks = [float(np.nanmax(np.abs(one), initial=0.0)) for one in values]
    top = (max(float(np.median(peaks)), _DECAYED * max(peaks)) if cut else 1.02 * max(peaks)) or 1.0
    low = min(float(np.nanmin(one, initial=np.inf)) for one in values)
    high = max(float(np.nanmax(one, initial=-np.inf)) for one in values)
    if low < -0.01 * top:
        return -top, top
    return (low, high) if 0 < 0.5 * high < low < high else (0.0, top)


def _pixels(title: str, values: np.ndarray, axes: Sequence[np.ndarray], **look: object) -> np.ndarray:
    """One frame, shape (height, width, 3), both even, as films want it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = field_panels([(title, values)], axes, None, **look)  # type: ignore[arg-type]
    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    return np.ascontiguousarray(pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2])


def _gif(path: Path, frames: Iterator[np.ndarray], rate: int) -> Path:
    from PIL import Image

    first, *rest = [Image.fromarray(frame).convert("P", palette=Image.Palette.ADAPTIVE) for frame in frames]
    draft = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    first.save(draft, format="GIF", save_all=True, append_images=rest, duration=round(1000 / rate), loop=0)
    draft.replace(path)
    return path


def _mp4(path: Path, frames: Iterator[np.ndarray], rate: int) -> Path:
    """Raises ImportError where imageio-ffmpeg is not installed."""
    from imageio_ffmpeg import write_frames

    first = next(frames)
    draft = path.with_name(f".{path.stem}.{os.getpid()}.mp4")  # ffmpeg tells the format by the ending
    film = write_frames(str(draft), first.shape[1::-1], fps=rate, macro_block_size=2, quality=8)
    film.send(None)
    film.send(first)
    for frame in frames:
        film.send(frame)
    film.close()
    draft.replace(path)
    return path
