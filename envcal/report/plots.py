"""Plots as SVG that stands inside the page, takes the page's own ink and is the same bytes every time."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

#: Okabe and Ito, "Color Universal Design" (2008): told apart with any kind of colour vision. Yellow, too pale on
#: white, is left out.
PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
DASHES = ("solid", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)))
# Colours that become the page's ink and its muted lines, so that a plot follows light and dark mode.
_INK, _MUTED = "#010203", "#040506"
_SIZE_IN = (5.2, 3.1)
_UV_RATIO = 1.5  # width to height of the chromaticity diagram


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of a plot: values over wavelengths, a label, and the number of the light whose colour it takes."""

    label: str
    values: Floats
    light: int
    style: str = ""


@dataclass(frozen=True, slots=True)
class Point:
    """A light in the chromaticity diagram: (u, v) of the evidence and of the spectrum that stands for it."""

    light: int
    measured: tuple[float, float] | None
    spectrum: tuple[float, float]
    bar: Floats | None
    """(u, v) [N, 2] along the locus within a standard deviation of the CCT."""


def colour_of(light: int) -> str:
    """The colour of a light by its number."""
    return PALETTE[light % len(PALETTE)]


def curves(
    wavelengths_nm: Floats, lines: Sequence[Curve], *, name: str, ylabel: str, legend: bool = True, small: bool = False
) -> str:
    """Curves over wavelength as SVG."""
    with _figure(_SIZE_IN if not small else (3.9, 2.3)) as figure:
        axes = figure.subplots()
        for line in lines:
            style = line.style or DASHES[line.light // len(PALETTE) % len(DASHES)]
            muted = line.style == "dotted"
            axes.plot(
                wavelengths_nm,
                line.values,
                color=_MUTED if muted else colour_of(line.light),
                linestyle=style,
                linewidth=1.2 if muted else 1.8,
                label=line.label,
            )
        axes.set_xlim(wavelengths_nm[0], wavelengths_nm[-1])
        axes.set_ylim(bottom=0)
        axes.set_xlabel("wavelength in nm")
        axes.set_ylabel(ylabel)
        axes.grid(visible=True, color=_MUTED, alpha=0.25, linewidth=0.5)
        if legend and lines:
            columns = min(3, len(lines))
            axes.legend(
                loc="lower left",
                bbox_to_anchor=(0, 1.01),
                ncols=columns,
                frameon=False,
                borderaxespad=0,
                handlelength=2.2,
            )
        return _svg(figure, name)


def chromaticities(points: Sequence[Point], *, name: str) -> str:
    """Lights in the CIE 1960 (u, v) diagram with the Planckian locus, as SVG."""
    from uplift.cct import planckian_uv

    temperatures = np.geomspace(1500, 25_000, 200)
    locus = planckian_uv(temperatures)
    with _figure((_SIZE_IN[0], 3.6)) as figure:
        axes = figure.subplots()
        axes.plot(*locus.T, color=_INK, linewidth=1.1)
        for cct in (2000, 2700, 3500, 5000, 6500, 10_000, 20_000):
            ends = isotherm(cct, np.array([-0.012, 0.012]))
            axes.plot(*ends.T, color=_MUTED, linewidth=0.7)
            axes.annotate(f"{cct} K", ends[0], color=_MUTED, fontsize=7.5, ha="left", va="top")
        for point in points:
            colour = colour_of(point.light)
            if point.bar is not None:
                axes.plot(*point.bar.T, color=colour, linewidth=5, alpha=0.35, solid_capstyle="butt")
            if point.measured is not None:
                pair = np.array([point.measured, point.spectrum])
                axes.plot(*pair.T, color=colour, linewidth=1)
                axes.plot(*point.measured, "o", color=colour, markersize=7, markeredgecolor=_INK, markeredgewidth=0.7)
            axes.plot(*point.spectrum, "x", color=_INK, markersize=6, markeredgewidth=1.3)
            where = point.measured or point.spectrum
            axes.annotate(str(point.light), where, xytext=(6, 6), textcoords="offset points", color=_INK, weight="bold")
        known = [p for point in points for p in (point.measured, point.spectrum) if p is not None]
        spread = np.concatenate(
            [locus[(temperatures > 1900) & (temperatures < 12_000)], np.array(known).reshape(-1, 2)]
        )
        middle, reach = (spread.min(axis=0) + spread.max(axis=0)) / 2, np.ptp(spread, axis=0) / 2 + 0.014
        reach = np.maximum(reach, [reach[1] * _UV_RATIO, reach[0] / _UV_RATIO])
        axes.set_xlim(middle[0] - reach[0], middle[0] + reach[0])
        axes.set_ylim(middle[1] - reach[1], middle[1] + reach[1])
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("u (CIE 1960)")
        axes.set_ylabel("v")
        axes.grid(visible=True, color=_MUTED, alpha=0.25, linewidth=0.5)
        return _svg(figure, name)


def isotherm(cct: float, duv: Floats) -> Floats:
    """Return (u, v) [N, 2] at distances `duv` [N] from the locus at `cct` kelvin, positive on the green side."""
    from uplift.cct import planckian_uv

    near = planckian_uv(np.array([cct / 1.002, cct, cct * 1.002]))
    along = near[0] - near[2]  # towards lower temperatures: u rises
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    return np.asarray(near[1] + np.asarray(duv)[:, np.newaxis] * (normal if normal[1] > 0 else -normal))


@contextlib.contextmanager
def _figure(size_in: tuple[float, float]) -> Iterator[Any]:
    """A figure outside of pyplot, under settings that end with it. Text is never read as formulas."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    settings: dict[str, Any] = {
        "svg.fonttype": "none",
        "text.parse_math": False,
        "font.family": ["DejaVu Sans"],
        "font.size": 9.2,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.unicode_minus": True,
        "path.simplify": False,
        **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color", "axes.edgecolor"), _INK),
    }
    with mpl.rc_context(settings):
        yield Figure(figsize=size_in, layout="constrained", facecolor="none")


def _svg(figure: Any, name: str) -> str:
    """The figure as an `<svg>` element that may stand in a page beside others: no ids in common, no metadata."""
    import matplotlib as mpl

    for axes in figure.axes:
        axes.set_facecolor("none")
    text = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<(metadata|style)\b.*?</\1>", "", svg, flags=re.DOTALL)
    used = set(re.findall(r'(?:href="|url\()#([\w.-]+)', svg))
    svg = re.sub(r' id="([\w.-]+)"', lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", svg)
    svg = re.sub(r'(href="|url\()#([\w.-]+)', rf"\1#{name}-\2", svg)
    svg = re.sub(r'font: ((?:\w+ )*[\d.]+px) [^;"]*', r"font: \1 system-ui, sans-serif", svg)
    svg = svg.replace(_INK, "currentColor").replace(_MUTED, "var(--muted)")
    head, rest = svg.split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    assert view, "matplotlib writes a viewBox"
    return f'<svg {view[0]} aria-hidden="true" focusable="false">{rest.strip()}'
