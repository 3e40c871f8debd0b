"""What comes of the renders: pictures for the screen, and the map of ΔE2000 between the lightings with its legend."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from envcal.atomic import replacing
from envcal.report import previews
from envcal.scene.render import Image, Rendered

Float64 = npt.NDArray[np.float64]

#: Renders are averaged over this many pixels a side before they are compared: ΔE sees noise as difference.
_SMOOTHING = 3
_SCALES = (1.0, 2.0, 5.0, 10.0, 20.0)
_COLOURS = "magma"
_INK, _PAPER, _MUTED = "#e6e6e6", "#151515", "#a3a3a3"


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """ΔE2000 [height, width] between two renders, and what noise alone makes of the mean."""

    delta_e: Float64
    mean: float
    p95: float
    largest: float
    noise: float


def compare(reference: Rendered, other: Rendered, *, gain: float) -> Difference:
    """Compare two renders; white is what the pictures show as white at this gain.

    Noise counts as difference. Half of the samples have twice its variance: what the mean is larger by when even and
    odd passes are compared by themselves tells, squared, the share of noise in the whole. Both lightings are rendered with
    the same random numbers, so much of their noise is common and does not count.
    """
    delta_e = _delta_e(reference.image, other.image, gain)
    mean = float(delta_e.mean())
    halves = [
        float(_delta_e(*pair, gain).mean()) for pair in ((reference.even, other.even), (reference.odd, other.odd))
    ]
    return Difference(
        delta_e,
        mean,
        float(np.percentile(delta_e, 95)),
        float(delta_e.max()),
        float(max((sum(halves) / 2) ** 2 - mean**2, 0.0) ** 0.5),
    )


def _delta_e(first: Image, second: Image, gain: float) -> Float64:
    from uplift.difference import delta_e_2000
    from uplift.spectrum import rgb_space

    smooth = [cv2.blur(image, (_SMOOTHING, _SMOOTHING)) for image in (first, second)]
    return delta_e_2000(smooth[0], smooth[1], rgb_space("sRGB"), white=1.0 / gain)


def gain_of(image: Image) -> float:
    """The exposure at which a render is shown."""
    return previews.exposure(image, np.eye(3))


def shown(image: Image, *, gain: float) -> npt.NDArray[np.uint8]:
    """A render [height, width, 3] of linear sRGB as 8-bit sRGB."""
    return previews.display(image, np.eye(3), gain=gain)


def write_png(path: Path, picture: npt.NDArray[np.uint8]) -> None:
    """Write an 8-bit RGB picture, whole or not at all."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done, f"PNG of {picture.shape}"
    with replacing(path) as part:
        part.write_bytes(data.tobytes())


def scale_end(difference: Difference) -> float:
    """The end of the colour bar: the first of 1, 2, 5, 10, 20 that 99 % of the pixels do not exceed."""
    high = float(np.percentile(difference.delta_e, 99))
    return next((end for end in _SCALES if high <= end), _SCALES[-1])


def field(delta_e: Float64, end: float) -> npt.NDArray[np.uint8]:
    """ΔE2000 [height, width] as colours: black is 0, the palest is `end` and more."""
    import matplotlib as mpl

    colours = mpl.colormaps[_COLOURS](np.clip(delta_e / end, 0, 1))
    return np.asarray(np.round(255 * colours[..., :3]), np.uint8)


def difference_picture(difference: Difference) -> npt.NDArray[np.uint8]:
    """The map of ΔE2000 as a picture of the same width, with a colour bar and a legend below."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width = difference.delta_e.shape[1]
    end = scale_end(difference)
    colours = mpl.colormaps[_COLOURS]
    strip = max(64, round(0.105 * width))
    dpi = 100
    size = max(7.0, 0.0145 * width)
    with mpl.rc_context({"font.family": ["DejaVu Sans"], "font.size": size * 72 / dpi, "text.parse_math": False}):
        figure = Figure(figsize=(width / dpi, strip / dpi), dpi=dpi, facecolor=_PAPER)
        axes: Any = figure.add_axes((0.03, 0.56, 0.45, 0.22))
        axes.imshow(np.linspace(0, 1, 256)[np.newaxis], aspect="auto", cmap=colours, extent=(0, end, 0, 1))
        axes.set_yticks([])
        axes.set_xticks(np.linspace(0, end, 6))
        more = "+" if difference.largest > end else ""
        axes.set_xticklabels([f"{v:g}{more if v == end else ''}" for v in np.linspace(0, end, 6)])
        axes.tick_params(colors=_INK, length=3, width=0.6)
        for spine in axes.spines.values():
            spine.set_color(_MUTED)
            spine.set_linewidth(0.6)
        text = (
            f"ΔE2000, spectra against RGB: mean {difference.mean:.2f}, 95 % below {difference.p95:.2f}",
            f"of which noise {difference.noise:.2f}; about 1 is just visible side by side",
        )
        for k, line in enumerate(text):
            figure.text(0.52, 0.66 - 0.34 * k, line, color=_INK if not k else _MUTED, va="center")
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        legend = np.asarray(canvas.buffer_rgba())[..., :3]
    return np.concatenate([field(difference.delta_e, end), legend[:, :width].astype(np.uint8)], axis=0)
