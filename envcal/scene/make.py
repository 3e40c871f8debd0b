"""`envcal mitsuba`: write the scene around an uplift file, and render it where Mitsuba is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from envcal import atomic, exr, provenance
from envcal.errors import EnvcalError
from envcal.export.opened import Opened, bands, conversion, open_uplift, refuse_overwriting, undeclared
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from envcal.scene import description
from uplift.spectrum import rgb_space

SIZE, SPP = (960, 540), 256
#: The RGB map of the comparison is reduced to this width at most.
_WIDEST = 2048
FIGURES = "figures.json"
#: Maps that are written into the folder, and must not fall on the uplift file.
WRITTEN = ("map_rgb.exr", "uplift.exr", "scaled.exr")


def make_scene(
    source: Path,
    folder: Path,
    *,
    size: tuple[int, int] | None = None,
    spp: int | None = None,
    variant: str = "auto",
    render: bool = True,
    progress: Progress = silent,
) -> Outcome:
    """Write scene.xml, a file for each lighting and render.py into `folder`; render them unless told not to.

    Renders are `uplift.exr` and `scaled.exr` (linear sRGB), the same as `.png` at one exposure, `difference.png`
    (ΔE2000) and `figures.json`. Without Mitsuba the scene is written all the same, and a warning says what to install.
    """
    atomic.check_folder(folder)
    opened = open_uplift(source)
    refuse_overwriting(source, folder, WRITTEN)
    # Before anything is written: a variant that is refused leaves no half a scene.
    used, remarks = _variant(variant) if render else (None, [])
    width, height = size or SIZE
    _write_rgb_map(opened, folder / "map_rgb.exr")
    atomic.write_text(folder / "scene.xml", description.scene_xml(width=width, height=height, spp=16))
    named = _relative(source, folder)
    atomic.write_text(folder / "uplift.xml", description.uplift_xml(named))
    atomic.write_text(folder / "scaled.xml", description.scaled_xml("map_rgb.exr"))
    atomic.write_text(folder / "render.py", description.SCRIPT)
    where = f"uplift.xml finds {source.resolve()} by the name {named}: move both together, or edit that line"
    hint = undeclared(opened.about)
    if used is None:
        return Outcome(f"scene.xml and render.py; not rendered; {where}", {"rendered": False}, [*remarks, *hint])
    from envcal.scene.render import SCALAR_SIZE, SCALAR_SPP

    if used.startswith("scalar"):
        size, spp = size or SCALAR_SIZE, spp or SCALAR_SPP
    figures = _render(folder, size or SIZE, spp or SPP, used, atomic.digest(source), progress)
    difference = figures["difference"]
    summary = (
        f"rendered {figures['width']}×{figures['height']}; spectra against RGB: ΔE2000 {difference['mean']:.2f} in the mean "
        f"(noise {difference['noise']:.2f}); {where}"
    )
    return Outcome(summary, {"rendered": True, **figures}, [*remarks, *hint])


def _variant(asked: str) -> tuple[str | None, list[str]]:
    """Set the Mitsuba variant; return its name and what is to be told. None: "auto" was asked and there is no Mitsuba."""
    from envcal.scene.render import set_variant

    try:
        used, remark = set_variant(asked)
    except EnvcalError as error:
        if asked != "auto":
            raise
        return None, [str(error)]
    if "spectral" not in used:
        raise EnvcalError(f"{used}: has no spectra, and the comparison is of spectra. Take a *_spectral variant.")
    return used, [remark] if remark else []


def _relative(source: Path, folder: Path) -> str:
    """The uplift file as seen from the scene: relative, so that both can be moved together, unless on another drive."""
    try:
        return Path(os.path.relpath(source.resolve(), folder.resolve())).as_posix()
    except ValueError:  # Windows: another drive
        return source.resolve().as_posix()


def _write_rgb_map(opened: Opened, out: Path) -> None:
    """Write the map's colours as linear sRGB in the layout of Mitsuba's envmap, for the comparison.

    Mitsuba's first and last rows stand at the poles; a row of this map is the middle of a band. With a row for each
    middle and one for each border, the mean of its neighbours, Mitsuba's interpolation meets ours everywhere, so
    that the renders differ by their spectra alone.
    """
    matrix = conversion(opened.space, rgb_space("sRGB", observer=opened.observer))
    height, width = opened.size
    step = -(-width // _WIDEST)
    rows: list[npt.NDArray[np.float64]] = []
    kept = np.empty((0, width, 3))
    for band in bands(opened):
        rgb = np.concatenate([kept, np.maximum(band.rgb(opened) @ matrix.T, 0.0)])
        whole = len(rgb) // step * step
        last = band.top + len(band.scale) == height
        end = len(rgb) if last else whole
        rows += [_reduced(rgb[k : min(k + step, end)], step) for k in range(0, end, step)]
        kept = rgb[end:]
    both = native_rows(np.stack(rows).astype(np.float32))
    attributes = {
        **provenance.attributes("mitsuba", settings={"rows": "poles and middles"}, inputs=[opened.path]),
        **provenance.colour_space("sRGB"),
    }
    exr.write(out, exr.rgb_planes(both), attributes=attributes)


def native_rows(middle: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return a lat-long map [2H + 1, W, C] in the layout of Mitsuba's envmap: rows at the poles, middles and borders.

    `middle` [H, W, C] has rows in the middles of bands of latitude. A row between two of them is their mean, so linear
    interpolation over the result is that over `middle`.
    """
    both = np.empty((2 * len(middle) + 1, *middle.shape[1:]), np.float32)
    both[1::2] = middle
    both[2:-1:2] = (middle[:-1] + middle[1:]) / 2
    both[0], both[-1] = middle[0], middle[-1]
    return both


def _reduced(rows: npt.NDArray[np.float64], step: int) -> npt.NDArray[np.float64]:
    """The mean of blocks of `step` columns of some rows [≤ step, width, 3]; the last block may be narrower."""
    mean = rows.mean(axis=0)
    edges = np.arange(0, mean.shape[0], step)
    counts = np.minimum(step, mean.shape[0] - edges)
    return np.add.reduceat(mean, edges, axis=0) / counts[:, np.newaxis]


def _render(
    folder: Path, size: tuple[int, int], spp: int, variant: str, digest: str, progress: Progress
) -> dict[str, Any]:
    from envcal.scene import pictures
    from envcal.scene.render import progress_of, render

    scene = folder / "scene.xml"
    rendered = {}
    for number, lighting in enumerate(("uplift", "scaled")):
        parameters = {"lighting": lighting}
        rendered[lighting] = render(scene, parameters, size=size, spp=spp, progress=progress_of(progress, number, 2))
    gain = pictures.gain_of(rendered["uplift"].image)
    for lighting, picture in rendered.items():
        attributes = {
            **provenance.attributes(
                "mitsuba", settings={"lighting": lighting, "spp": spp, "variant": variant}, inputs=[scene]
            ),
            **provenance.colour_space("sRGB"),
        }
        exr.write(folder / f"{lighting}.exr", exr.rgb_planes(picture.image), attributes=attributes)
        pictures.write_png(folder / f"{lighting}.png", pictures.shown(picture.image, gain=gain))
    difference = pictures.compare(rendered["uplift"], rendered["scaled"], gain=gain)
    pictures.write_png(folder / "difference.png", pictures.difference_picture(difference))
    figures = {
        "uplift": digest,
        "variant": variant,
        "width": size[0],
        "height": size[1],
        "spp": spp,
        "exposure_stops": float(np.log2(gain)),
        "difference": {
            "mean": difference.mean,
            "p95": difference.p95,
            "max": difference.largest,
            "noise": difference.noise,
            "outside": difference.outside,
            "outside_mean": difference.outside_mean,
        },
    }
    atomic.write_json(folder / FIGURES, figures)
    return figures
