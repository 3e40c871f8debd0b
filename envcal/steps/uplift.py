"""Map and lights → three coefficients and a scale per pixel."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.config import UpliftSettings, parse_wavelengths
from envcal.errors import EnvcalError
from envcal.lights_file import Lights, parse
from envcal.maps import Map
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from envcal.uplift_file import ATTRIBUTE, CHANNELS, About, Emission

if TYPE_CHECKING:
    from uplift.pixels import Uplifted
    from uplift.spectrum import Observer, RGBSpace

Image = npt.NDArray[np.float32]

#: Pixels that are solved at a time: enough to keep every core busy, little enough for the memory of a laptop.
TILE_PIXELS = 1 << 20


def read_lights(clusters: Path) -> Lights:
    """Read the lights in the header of a file that `envcal cluster` wrote."""
    return parse(exr.header(clusters).json("envcalLights"), place=clusters)


def uplift(
    source: Map,
    clusters: Path,
    out: Path,
    settings: UpliftSettings,
    *,
    progress: Progress = silent,
) -> Outcome:
    """Uplift a map under the lights of `clusters` and write the uplift file `out`, in tiles of rows.

    The round trip back to RGB is measured on every pixel, in double precision and as stored.
    """
    from uplift.pixels import Status
    from uplift.spectrum import observer, rgb_space

    lights = read_lights(clusters)
    height, width = source.image.shape[:2]
    _check_same_map(source, clusters, lights)
    seen = observer(*parse_wavelengths(lights.wavelengths), name=lights.observer)
    space = rgb_space(source.space, observer=seen)
    solve, emissions = _solver(lights, settings, seen, space)
    about = About(
        method=settings.method,
        space=source.space,
        observer=lights.observer,
        wavelengths_nm=[float(w) for w in seen.wavelengths_nm],
        clusters=emissions,
        status={str(int(status)): status.name.lower() for status in Status},
    )
    attributes = {
        **provenance.attributes("uplift", settings=settings.model_dump(mode="json"), inputs=[source.path, clusters]),
        **provenance.colour_space(source.space),
        "envmap": True,
        ATTRIBUTE: about.model_dump(mode="json"),
    }
    tally = Tally(seen, space)
    rows = max(1, TILE_PIXELS // width)
    with exr.Writer(out, (height, width), channels=CHANNELS, attributes=attributes) as writer:
        for top, planes in exr.bands(clusters, ["cluster"], rows=rows):
            labels = planes["cluster"]
            if int(labels.max()) >= len(lights.lights):
                raise EnvcalError(
                    f"{clusters}: names cluster {int(labels.max())}, but has {len(lights.lights)} lights. Run `envcal "
                    f"cluster` again."
                )
            rgb = source.image[top : top + len(labels)]
            solved = solve(rgb, labels)
            writer.rows(_stored(rgb, solved))
            tally.add(rgb, solved)
            progress(top + len(labels), height)
    return tally.outcome()


def _check_same_map(source: Map, clusters: Path, lights: Lights) -> None:
    size = exr.header(clusters).size
    if size != source.image.shape[:2] or lights.space != source.space:
        height, width = source.image.shape[:2]
        raise EnvcalError(
            f"{clusters}: {size[1]}×{size[0]} in {lights.space}, but the map {source.path} is {width}×{height} in "
            f"{source.space}. Run `envcal cluster` on this map."
        )


def _solver(
    lights: Lights, settings: UpliftSettings, seen: Observer, space: RGBSpace
) -> tuple[Callable[[Image, npt.NDArray[np.uint32]], Uplifted], list[Emission]]:
    """The function that solves a tile, and the emissions that its result counts by index."""
    from uplift.spectrum import illuminant

    d65 = [float(v) for v in illuminant("D65", seen)]
    if settings.method == "scaled":
        from uplift.scaled import uplift_scaled

        only = Emission(type="daylight", cct=None, duv=None, source="D65 for every pixel", confidence=1.0, emission=d65)
        return (lambda rgb, _labels: uplift_scaled(rgb, observer=seen, space=space)), [only]
    from uplift.pixels import uplift_pixels
    from uplift.table import build_table

    tables = [
        build_table(light.emission, observer=seen, space=space, nodes=settings.nodes, factor=settings.brightness)
        for light in lights.lights
    ]
    emissions = [
        Emission(
            type=light.type,
            cct=light.cct,
            duv=light.duv,
            source=light.source,
            confidence=light.confidence,
            emission=light.emission,
        )
        for light in lights.lights
    ]
    fallback = "D65, for colours that their own light cannot show"
    emissions.append(Emission(type="fallback", cct=None, duv=None, source=fallback, confidence=1.0, emission=d65))
    return (lambda rgb, labels: uplift_pixels(rgb, labels, tables, precision=settings.precision)), emissions


def _stored(rgb: Image, solved: Uplifted) -> dict[str, npt.NDArray[Any]]:
    """The channels of the uplift file. A pixel without radiance gets the coefficients of grey, not of black, whose
    −∞ would turn into NaN in the formula that the file documents."""
    dark = solved.scale == 0
    coefficients = np.where(dark[..., np.newaxis], 0.0, solved.coefficients).astype(np.float32)
    planes: dict[str, npt.NDArray[Any]] = {f"c{k}": coefficients[..., k] for k in range(3)}
    planes |= {"scale": solved.scale.astype(np.float32), "cluster": solved.emission, "status": solved.status}
    return planes | exr.rgb_planes(rgb)


class Tally:
    """Counts of pixels by status and the round trip back to RGB, gathered tile by tile."""

    def __init__(self, seen: Observer, space: RGBSpace) -> None:
        from uplift.pixels import Status

        self._seen, self._space = seen, space
        self._counts = dict.fromkeys(Status, 0)
        self._sum = self._sum_stored = self._worst = self._worst_stored = self._shift = 0.0
        self._nan = self._darkened = 0

    def add(self, rgb: Image, solved: Uplifted) -> None:
        """Take a tile into account."""
        from uplift.difference import delta_e_2000
        from uplift.pixels import Status
        from uplift.radiance import rgb_of

        for status, count in solved.counts.items():
            self._counts[status] += count
        self._shift = max(self._shift, solved.largest_shift)
        self._darkened += int(((solved.status == Status.CLOSEST) & (solved.scale == 0)).sum())
        kept = (solved.status == Status.EXACT) | (solved.status == Status.FALLBACK)
        if not kept.any():
            return
        asked = rgb[kept].astype(np.float64)
        coefficients, scale, emission = solved.coefficients[kept], solved.scale[kept], solved.emission[kept]
        for stored in (False, True):
            if stored:
                coefficients = coefficients.astype(np.float32).astype(np.float64)
                scale = scale.astype(np.float32).astype(np.float64)
            back = rgb_of(coefficients, scale, emission, solved.emissions, observer=self._seen, space=self._space)
            difference = delta_e_2000(asked, back, self._space)
            self._nan += int(np.isnan(difference).sum())
            total, worst = float(np.nansum(difference)), float(np.nanmax(difference))
            if stored:
                self._sum_stored, self._worst_stored = self._sum_stored + total, max(self._worst_stored, worst)
            else:
                self._sum, self._worst = self._sum + total, max(self._worst, worst)

    def outcome(self) -> Outcome:
        """The figures of the whole map."""
        from uplift.pixels import Status

        pixels = sum(self._counts.values())
        kept = max(1, self._counts[Status.EXACT] + self._counts[Status.FALLBACK])
        figures = {
            "pixels": pixels,
            "status": {status.name.lower(): count for status, count in self._counts.items()},
            "round_trip_delta_e": {"mean": self._sum / kept, "max": self._worst},
            "round_trip_delta_e_stored": {"mean": self._sum_stored / kept, "max": self._worst_stored},
            "round_trip_nan": self._nan,
            "largest_shift_delta_e": self._shift,
            "darkened": self._darkened,
        }
        summary = f"round trip ΔE2000 at most {self._worst:.1e} ({self._worst_stored:.1e} as stored)"
        others = [f"{count} {status.name.lower()}" for status, count in self._counts.items() if count and status]
        warnings = []
        if self._counts[Status.FALLBACK]:
            warnings.append(
                f"{self._counts[Status.FALLBACK]} of {pixels} pixels have colours that their light cannot show; they keep "
                f"their colour under D65. If they are many, declare the light there (`cluster.lights`)."
            )
        if self._counts[Status.CLOSEST]:
            warnings.append(
                f"{self._counts[Status.CLOSEST]} of {pixels} pixels have colours that no light can show (noise, "
                f"coloured fringes at the rims of lamps, a poor chart fit); they moved by up to ΔE2000 {self._shift:.3g}, and "
                f"{self._darkened} of them, of negative luminance, became black. A few at the rims of lamps do no harm; the "
                f"report shows where they are."
            )
        if self._counts[Status.MISSING]:
            warnings.append(
                f"{self._counts[Status.MISSING]} of {pixels} pixels are missing (clipped in every frame) and have no "
                f"radiance: they are black holes in the light. Add a shorter exposure to the bracket."
            )
        return Outcome("; ".join([summary, *others]), figures, warnings)
