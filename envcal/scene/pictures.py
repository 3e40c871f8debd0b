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
#: A colour is outside of sRGB if a component is below minus this share of the largest; noise alone stays above it.
_OUTSIDE = 0.01
_COLOURS = "magma"
#: What is counted apart is hatched: the width of a stripe in pixels, and the two greys.
_STRIPE, _HATCH = 4, (72, 104)
#: From this width on, in pixels, the colour bar has six figures rather than two.
_WIDE = 300
_INK, _PAPER, _MUTED = "#e6e6e6", "#151515", "#a3a3a3"


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """ΔE2000 [height, width] between two renders, its figures, and what noise alone makes of the mean.

    `mean`, `p95`, `largest` and `noise` leave the background out where its colour is outside of sRGB; `outside` is the
    share of the picture that this is, `outside_mean` its own mean ΔE2000 (0 where there is none), `apart` [height, width]
    where it is.
    """

    delta_e: Float64
    mean: float
    p95: float
    largest: float
    noise: float
    outside: float = 0.0
    outside_mean: float = 0.0
    apart: npt.NDArray[np.bool_] | None = None


def compare(reference: Rendered, other: Rendered, *, gain: float) -> Difference:
    """Compare two renders; white is what the pictures show as white at this gain.

    Noise counts as difference. Half of the samples have twice its variance: what the mean is larger by when even and
    odd passes are compared by themselves tells, squared, the share of noise in the whole. Both lightings are rendered with
    the same random numbers, so much of their noise is common and does not count.

    Mitsuba's own map cannot have the colours outside of sRGB. Where such a colour is seen in the background the pictures
    differ by that and not by what the light does to surfaces, so these pixels are counted apart.
    """
    delta_e = _delta_e(reference.image, other.image, gain)
    apart = outside_srgb(reference)
    counted = ~apart if not apart.all() else np.ones_like(apart)
    mean = float(delta_e[counted].mean())
    halves = [
        float(_delta_e(*pair, gain)[counted].mean())
        for pair in ((reference.even, other.even), (reference.odd, other.odd))
    ]
    return Difference(
        delta_e,
        mean,
        float(np.percentile(delta_e[counted], 95)),
        float(delta_e[counted].max()),
        float(max((sum(halves) / 2) ** 2 - mean**2, 0.0) ** 0.5),
        float(apart.mean()),
        float(delta_e[apart].mean()) if apart.any() else 0.0,
        apart,
    )


def outside_srgb(picture: Rendered) -> npt.NDArray[np.bool_]:
    """Return the background pixels [height, width] whose colour is outside of sRGB, or averaged with one that is."""
    if picture.background is None:
        return np.zeros(picture.image.shape[:2], np.bool_)
    smooth = _smooth(picture.image)
    outside = smooth.min(axis=2) < -_OUTSIDE * smooth.max(axis=2)
    near = cv2.dilate((outside & picture.background).astype(np.uint8), np.ones((_SMOOTHING, _SMOOTHING), np.uint8)) > 0
    return np.asarray(near & picture.background, np.bool_)


def _smooth(image: Image) -> Image:
    return np.asarray(cv2.blur(image, (_SMOOTHING, _SMOOTHING)), np.float32)


def _delta_e(first: Image, second: Image, gain: float) -> Float64:
    from uplift.difference import delta_e_2000
    from uplift.spectrum import rgb_space

    return delta_e_2000(_smooth(first), _smooth(second), rgb_space("sRGB"), white=1.0 / gain)


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
    """The end of the colour bar: the first of 1, 2, 5, 10, 20 that 99 % of the pixels that count do not exceed."""
    high = float(np.percentile(_counted(difference), 99))
    return next((end for end in _SCALES if high <= end), _SCALES[-1])


def _counted(difference: Difference) -> Float64:
    """The ΔE2000 [n] of the pixels that are not counted apart; all of them if that is the whole picture."""
    apart = difference.apart
    return difference.delta_e.ravel() if apart is None or apart.all() else difference.delta_e[~apart]


def hatched(picture: npt.NDArray[np.uint8], apart: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """Return the picture [height, width, 3] with grey stripes in the place of what is counted apart: no colour of the scale."""
    y, x = np.indices(apart.shape)
    stripes = np.where((x + y) // _STRIPE % 2 == 0, *_HATCH).astype(np.uint8)
    return np.where(apart[..., np.newaxis], stripes[..., np.newaxis], picture)


def field(delta_e: Float64, end: float) -> npt.NDArray[np.uint8]:
    """ΔE2000 [height, width] as colours: black is 0, the palest is `end` and more."""
    import matplotlib as mpl

    colours = mpl.colormaps[_COLOURS](np.clip(delta_e / end, 0, 1))
    return np.asarray(np.round(255 * colours[..., :3]), np.uint8)


def difference_picture(difference: Difference) -> npt.NDArray[np.uint8]:
    """The map of ΔE2000 as a picture of the same width, with a colour bar and, wrapped to the width, a legend below."""
    end = scale_end(difference)
    picture = field(difference.delta_e, end)
    if difference.apart is not None:
        picture = hatched(picture, difference.apart)
    return np.concatenate([picture, _legend(difference, end, picture.shape[1])], axis=0)


def caption(difference: Difference) -> list[str]:
    """What is to be read below the map of ΔE2000, a sentence a line."""
    lines = [
        f"ΔE2000, spectra against RGB: mean {difference.mean:.2f}, 95 % below {difference.p95:.2f}",
        f"of which noise {difference.noise:.2f}; about 1 is just visible side by side",
    ]
    if difference.outside > 0:
        lines.append(
            f"counted apart, hatched: background outside of sRGB, {100 * difference.outside:.1f} % of the picture, mean "
            f"{difference.outside_mean:.2f}"
        )
    return lines


def _legend(difference: Difference, end: float, width: int) -> npt.NDArray[np.uint8]:
    """The colour bar with its scale, and the caption [height, width, 3], in letters that grow with the width."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    dpi = 100
    letters = max(9.0, 0.0145 * width)  # pixels
    margin, bar, line = round(max(6.0, 0.02 * width)), round(1.3 * letters), round(1.5 * letters)
    with mpl.rc_context({"font.family": ["DejaVu Sans"], "font.size": letters * 72 / dpi, "text.parse_math": False}):
        lines = [
            (part, _MUTED if number else _INK)
            for number, sentence in enumerate(caption(difference))
            for part in _wrapped(sentence, width - 2 * margin, letters, dpi)
        ]
        height = 2 * margin + bar + 2 * line + len(lines) * line
        figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi, facecolor=_PAPER)
        axes: Any = figure.add_axes((margin / width, 1 - (margin + bar) / height, 1 - 2 * margin / width, bar / height))
        axes.imshow(
            np.linspace(0, 1, 256)[np.newaxis], aspect="auto", cmap=mpl.colormaps[_COLOURS], extent=(0, end, 0, 1)
        )
        axes.set_yticks([])
        ticks = np.linspace(0, end, 6 if width >= _WIDE else 2)
        axes.set_xticks(ticks)
        more = "+" if _counted(difference).max() > end else ""
        labels = axes.set_xticklabels([f"{v:g}{more if v == end else ''}" for v in ticks])
        # The outer ones stand within the bar, so that none is cut at the picture's edge.
        labels[0].set_horizontalalignment("left")
        labels[-1].set_horizontalalignment("right")
        axes.tick_params(colors=_INK, length=3, width=0.6, pad=2)
        for spine in axes.spines.values():
            spine.set_color(_MUTED)
            spine.set_linewidth(0.6)
        for number, (text, colour) in enumerate(lines):
            below = margin + bar + (2 + number + 0.5) * line
            figure.text(margin / width, 1 - below / height, text, color=colour, va="center")
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[:height, :width, :3].astype(np.uint8)


def _wrapped(text: str, width: float, letters: float, dpi: int) -> list[str]:
    """Break a text at its blanks into lines of at most `width` pixels in letters of this size, as they are drawn."""
    from matplotlib.backends.backend_agg import RendererAgg
    from matplotlib.font_manager import FontProperties

    font, drawing = FontProperties(family="DejaVu Sans", size=letters * 72 / dpi), RendererAgg(16, 16, dpi)
    lines = [""]
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and drawing.get_text_width_height_descent(longer, font, False)[0] > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
