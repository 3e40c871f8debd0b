"""Map and lights → a spectrum per pixel: three coefficients and a scale, or a mixture of eight."""

from __future__ import annotations

from pathlib import Path

from envcal import exr, provenance
from envcal.config import UpliftSettings, parse_wavelengths
from envcal.errors import EnvcalError
from envcal.lights_file import Lights, parse
from envcal.maps import Map
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from envcal.steps.uplift.methods import method_of
from envcal.steps.uplift.mixing import with_mixtures
from envcal.steps.uplift.tally import Tally
from envcal.uplift_file import ATTRIBUTE, channels

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
    reported: bool = False,
) -> Outcome:
    """Uplift a map under the lights of `clusters` and write the uplift file `out`, in tiles of rows.

    The round trip back to RGB is measured on every pixel, in double precision and as stored. `reported`: in
    a run, whose report shows where pixels are that messages speak of.
    """
    from uplift.spectrum import observer, rgb_space

    lights = read_lights(clusters)
    height, width = source.image.shape[:2]
    _check_same_map(source, clusters, lights)
    seen = observer(*parse_wavelengths(lights.wavelengths), name=lights.observer)
    space = rgb_space(source.space, observer=seen)
    # A file of another maker may name one light a pixel only.
    both = {"second", "weight"} <= set(exr.header(clusters).channels)
    emitting, mixtures = with_mixtures(lights, settings, seen) if both else (lights, None)
    method = method_of(settings, emitting, seen, space)
    needed = ["cluster"] if mixtures is None else ["cluster", "second", "weight"]
    attributes = {
        **provenance.attributes(
            "uplift", settings=settings.model_dump(mode="json"), inputs=[source.path, clusters], unit=source.unit
        ),
        **provenance.colour_space(source.space),
        "envmap": True,
        ATTRIBUTE: method.about.model_dump(mode="json"),
    }
    tally = Tally(method, space, height, photographed=source.photographed, reported=reported)
    rows = max(1, TILE_PIXELS // width)
    with exr.Writer(out, (height, width), channels=channels(method.about), attributes=attributes) as writer:
        for top, planes in exr.bands(clusters, needed, rows=rows):
            labels = planes["cluster"]
            most = max(int(planes[name].max()) for name in needed if name != "weight")
            if most >= len(lights.lights):
                raise EnvcalError(
                    f"{clusters}: names cluster {most}, but has {len(lights.lights)} lights. Run `envcal cluster` again."
                )
            if mixtures is not None:
                labels = mixtures.labels(labels, planes["second"], planes["weight"])
            rgb = source.image[top : top + len(labels)]
            solved = method.solve(rgb, labels)
            writer.rows(solved.planes() | exr.rgb_planes(rgb))
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
