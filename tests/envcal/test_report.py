"""The page about a run: whole, self-contained, harmless, and true to what stands in the output folder."""

from __future__ import annotations

import base64
import json
import math
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from envcal import exr, provenance
from envcal.errors import EnvcalError
from envcal.lights_file import LightRecord, Lights
from envcal.profile import Camera, Chart, Lamp, Patch, Profile
from envcal.report import plots, previews, write_report
from envcal.report.page import SECTIONS
from envcal.spectral_exr import channel, channels
from envcal.unit import Unit
from envcal.unit import attributes as unit_attributes
from envcal.uplift_file import ATTRIBUTE, CHANNELS, About, Emission

SPACE = "ITU-R BT.2020"
WIDTH, HEIGHT = 256, 128
GRID = np.arange(380.0, 781.0, 5.0)
HOSTILE = "<script>alert(1)</script>"
BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)


# ---- a small finished run, made without the stages -------------------------------------------------------------------


def room(width: int = WIDTH, *, missing: bool = True) -> np.ndarray:
    """A lat-long picture [H, W, 3]: grey walls, a warm lamp, a cool window, a chart and a D65 module."""
    height = width // 2
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    image = np.empty((height, width, 3))
    image[...] = (0.12 + 0.10 * np.sin(2 * np.pi * u) + 0.05 * v)[..., np.newaxis] * np.array([1.0, 0.9, 0.75])
    image[(v > 0.62)] *= np.array([0.7, 0.5, 0.35])
    image[np.hypot((u - 0.25) * 2, v - 0.25) < 0.03] = np.array([90.0, 55.0, 22.0])
    image[(abs(u - 0.72) < 0.06) & (abs(v - 0.4) < 0.12)] = np.array([9.0, 11.0, 14.0])
    if missing:
        image[np.hypot((u - 0.25) * 2, v - 0.25) < 0.012] = np.nan
    return image.astype(np.float32)


def chart_profile(width: int = WIDTH) -> Profile:
    box = np.array([[0.44, 0.52], [0.52, 0.52], [0.52, 0.62], [0.44, 0.62]]) * [width, width // 2]
    patches, quads = [], []
    rng = np.random.default_rng(5)
    for k in range(24):
        row, column = divmod(k, 6)
        centre = box[0] + (box[2] - box[0]) * [(column + 0.5) / 6, (row + 0.5) / 4]
        quads.append([tuple(centre + np.array(d) * width / 400) for d in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        target = np.array([0.9, 0.9, 0.9]) * (0.7 ** (k - 18)) if k >= 18 else rng.uniform(0.02, 0.6, 3)
        patches.append(
            Patch(
                name=f"patch {k}",
                camera_rgb=tuple(0.6 * target),
                noise=(1e-4, 1e-4, 2e-4),
                pixels=40,
                light=1.0,
                target_rgb=tuple(target),
                fitted_rgb=tuple(target * rng.uniform(0.95, 1.05, 3)),
                delta_e=float(rng.uniform(0.3, 3)) if k != 7 else 5.25,
                delta_e_left_out=float(rng.uniform(1, 4)),
            )
        )
    return Profile(
        working_space=SPACE,
        camera=Camera(model="Example EX-1", lens="8 mm", iso=100.0, f_number=8.0),
        reference_shot="reference.exr",
        reference_digest="a" * 64,
        chart=Chart(
            reference="ColorChecker24 - After November 2014",
            found="auto",
            corners=[tuple(p) for p in box],
            quads=quads,
            score=2.0,
            fit="linear",
            patches=patches,
        ),
        matrix=((1.6, -0.5, -0.1), (-0.2, 1.4, -0.2), (0.05, -0.6, 1.7)),
    )


def lamp_profile(profile: Profile, width: int = WIDTH) -> Profile:
    lamp = Lamp(
        found="auto",
        polygon=[
            (0.53 * width, 0.27 * width),
            (0.55 * width, 0.27 * width),
            (0.55 * width, 0.3 * width),
            (0.53 * width, 0.3 * width),
        ],
        pixels=120,
        clipped=3,
        rgb=(2.0, 1.9, 2.2),
        noise=(1e-3, 1e-3, 1e-3),
        transform="CAT16",
        luminance="lamp",
        cone_gains=(0.51, 0.52, 0.46),
    )
    matrix = ((1 / 2.0, 0.0, 0.0), (0.0, 1 / 1.9, 0.0), (0.0, 0.0, 1 / 2.2))
    return profile.model_copy(update={"lamp": lamp, "balance_matrix": matrix})


def emission(cct: float, *, lines: bool = False) -> list[float]:
    power = GRID**-5.0 / np.expm1(1.4388e7 / (GRID * cct))
    if lines:
        power = 0.2 * power / power.max() + sum(np.exp(-(((GRID - w) / 6) ** 2)) for w in (435, 545, 610))
    luminous = np.exp(-0.5 * ((GRID - 556) / 43) ** 2)
    return [float(v) for v in power / (power @ luminous * 106.9 / luminous.sum() * 1.0)]


def lights(*names: str) -> Lights:
    common: dict[str, Any] = {"declared": False, "source": "smooth spectrum of its colour temperature"}
    return Lights(
        wavelengths="380:780:5",
        observer="CIE 1931 2 Degree Standard Observer",
        space=SPACE,
        sky=True,
        lights=[
            LightRecord(
                cluster=0,
                type="incandescent",
                name=names[0] if names else "",
                cct=2800.0,
                duv=0.0,
                cct_seen=2790.0,
                cct_sigma=60.0,
                duv_seen=0.0012,
                outdoor=False,
                share=0.7,
                at=(0.25, 0.25),
                confidence=0.85,
                remedy="",
                emission=emission(2790),
                **common,
            ),
            LightRecord(
                cluster=1,
                type="fluorescent",
                name=names[1] if len(names) > 1 else "",
                cct=None,
                duv=None,
                cct_seen=None,
                cct_sigma=None,
                duv_seen=None,
                outdoor=True,
                share=0.3,
                at=(0.72, 0.4),
                confidence=0.3,
                remedy="declare this lamp under cluster.lights",
                emission=emission(6000, lines=True),
                **common,
            ),
        ],
    )


def record(**more: Any) -> dict[str, Any]:
    base = {
        "key": "k",
        "light": "",
        "seconds": 1.25,
        "settings": {},
        "inputs": [],
        "outputs": {},
        "summary": "done",
        "figures": {},
        "warnings": [],
    }
    return {**base, **more}


def finished_run(
    output: Path, *, width: int = WIDTH, missing: bool = True, names: tuple[str, ...] = ("desk lamp",)
) -> dict[str, Any]:
    """Leave in `output` what all stages leave, and return the records of `run.json`."""
    image = room(width, missing=missing)
    space = provenance.colour_space(SPACE)
    green_cast = image * np.array([0.5, 0.9, 0.6], np.float32) * 1e-3
    exr.write(
        output / "merge/reference.exr",
        exr.with_lost(green_cast),
        attributes=provenance.colour_space(provenance.CAMERA_RGB),
    )
    exr.write(output / "correct/reference.exr", exr.with_lost(image), attributes=space)
    profile = chart_profile(width)
    profile.write(output / "correct/profile.json")
    balanced = image * np.array([0.5, 0.53, 0.45], np.float32)
    exr.write(output / "balance/reference.exr", exr.with_lost(balanced), attributes=space)
    lamp_profile(profile, width).write(output / "balance/profile.json")
    exr.write(output / "panorama/environment.exr", exr.with_lost(balanced), attributes=space | {"envmap": True})
    found = lights(*names)
    labels = (np.indices(image.shape[:2])[1] > width // 2).astype(np.uint32)
    sky = np.zeros(image.shape[:2], np.uint32)
    sky[: width // 16] = 1
    exr.write(
        output / "cluster/clusters.exr", {**exr.rgb_planes(balanced), "cluster": labels, "sky": sky}, attributes=space
    )
    (output / "cluster/lights.json").write_text(found.model_dump_json(), encoding="utf-8")
    _write_uplift(output / "uplift/environment.exr", balanced, labels, found)
    _write_spectra(output / "spectra/environment.exr", balanced)
    _write_scene(output / "mitsuba")
    return {
        "merge": record(
            summary="5 frames",
            inputs=[["a.dng", "f" * 64]],
            outputs={"merge/reference.exr": "1" * 64},
            settings={"merge": {"gain_e_per_dn": 2.0, "read_noise_e": None, "defects": True}},
            figures={"shots": {"reference": {
                "camera": profile.camera.model_dump(), "cfa": "RGGB", "lost": 7, "defects": 12, "gain_e_per_dn": 2.0, "read_noise_e": 3.0,
                "frames": [{"name": "a.dng", "exposure_s": 0.01, "exposure": "1/100", "clipped": 0.05, "share": 0.6}],
            }}},
            warnings=["a pixel is lost"],
        ),
        "correct": record(inputs=[["reference.exr", "1" * 64]], outputs={"correct/reference.exr": "2" * 64}, settings={"working_space": "sRGB"}),
        "balance": record(inputs=[["reference.exr", "2" * 64]], outputs={"balance/reference.exr": "3" * 64}),
        "panorama": record(inputs=[["reference.exr", "3" * 64]], outputs={"panorama/environment.exr": "4" * 64}),
        "cluster": record(inputs=[["environment.exr", "4" * 64]], outputs={"cluster/clusters.exr": "5" * 64}, warnings=["a light is uncertain"]),
        "uplift": record(
            inputs=[["environment.exr", "4" * 64], ["clusters.exr", "5" * 64]],
            outputs={"uplift/environment.exr": "6" * 64},
            figures={
                "pixels": image[..., 0].size, "round_trip_nan": 0, "largest_shift_delta_e": 1.25,
                "status": {"exact": 32000, "black": 0, "fallback": 700, "closest": 60, "missing": 8},
                "round_trip_delta_e": {"mean": 1e-11, "max": 4.2e-9}, "round_trip_delta_e_stored": {"mean": 1e-4, "max": 8e-4},
            },
        ),
        "spectra": record(inputs=[["environment.exr", "6" * 64]], outputs={"spectra/environment.exr": "7" * 64}),
        "report": record(seconds=math.pi),
    }  # fmt: skip


def _write_uplift(
    path: Path, image: np.ndarray, labels: np.ndarray, found: Lights, method: str = "constrained"
) -> None:
    about = About(
        method=method,
        space=SPACE,
        observer=found.observer,
        wavelengths_nm=[float(w) for w in GRID],
        clusters=[
            Emission(type=x.type, cct=x.cct, duv=x.duv, source=x.source, confidence=1.0, emission=x.emission)
            for x in found.lights
        ],
        status={},
    )
    y = np.nan_to_num(image.mean(axis=2))
    status = np.zeros(labels.shape, np.uint32)
    status[-20:, :40], status[np.isnan(image).any(axis=2)] = 2, 4
    planes = {
        "c0": np.full(labels.shape, 1e-5, np.float32), "c1": np.full(labels.shape, -0.01, np.float32),
        "c2": (2.5 + 0.2 * y).astype(np.float32), "scale": y.astype(np.float32), "cluster": labels, "status": status,
    }  # fmt: skip
    with exr.Writer(
        path, labels.shape, channels=CHANNELS, attributes={ATTRIBUTE: about.model_dump(mode="json")}
    ) as writer:
        writer.rows(planes | exr.rgb_planes(image))


def _write_spectra(path: Path, image: np.ndarray) -> None:
    wavelengths = [450.0, 550.0, 650.0, 700.0]
    planes = {channel(w): np.nan_to_num(image[..., k % 3]) for k, w in enumerate(wavelengths)}
    with exr.Writer(
        path, image.shape[:2], channels=channels(wavelengths, half=True), attributes={"unit": "relative"}
    ) as writer:
        writer.rows(planes | exr.rgb_planes(np.nan_to_num(image)))


def _write_scene(folder: Path, *, uplift: str = "6" * 64) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, height in (("uplift", 54), ("scaled", 54), ("difference", 64)):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((height, 96, 3), 90, np.uint8))
    difference = {"mean": 1.25, "p95": 3.5, "max": 11.0, "noise": 0.2}
    figures = {
        "uplift": uplift, "variant": "llvm_ad_spectral", "width": 96, "height": 54, "spp": 64, "exposure_stops": -1.5, "difference": difference,
    }  # fmt: skip
    (folder / "figures.json").write_text(json.dumps(figures), encoding="utf-8")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    output = tmp_path_factory.mktemp("output")
    records = finished_run(output)
    write_report(output, records)
    return output, records, (output / "report.html").read_text(encoding="utf-8")


# ---- what is told of a page by parsing it ----------------------------------------------------------------------------

VOID = {"meta", "img", "input", "br", "link", "hr", "wbr"}


class Outline(HTMLParser):
    """Elements, their attributes and text; refuses a page whose tags do not close in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self._open: list[str] = []
        self.feed(page)
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open and self._open[-1] == tag, f"</{tag}> closes {self._open[-1:]} at {self.getpos()}"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())


def test_the_page_refers_to_nothing_outside_itself(run: tuple[Path, dict[str, Any], str]) -> None:
    outline = Outline(run[2])
    assert not outline.all("script") and not outline.all("link") and not outline.all("iframe")
    for tag, attributes in outline.elements:
        for name, value in attributes.items():
            if name.split(":")[-1] in ("src", "href", "srcset", "action", "data", "poster"):
                assert (value or "").startswith(("#", "data:image/")), (tag, name, (value or "")[:60])
            assert not name.startswith("on"), (tag, name)
    assert not re.search(r"url\((?!#)|@import|https?://", run[2])


def test_every_element_is_closed_and_no_id_stands_twice(run: tuple[Path, dict[str, Any], str]) -> None:
    ids = [attributes["id"] for _, attributes in Outline(run[2]).elements if "id" in attributes]
    assert len(ids) == len(set(ids))


def test_references_inside_the_page_lead_somewhere(run: tuple[Path, dict[str, Any], str]) -> None:
    ids = {attributes.get("id") for _, attributes in Outline(run[2]).elements}
    wanted = set(re.findall(r'(?:href="|url\()#([\w.-]+)', run[2])) | set(re.findall(r'labelledby="([\w-]+)"', run[2]))
    assert wanted and wanted <= ids


def test_a_finished_run_has_every_section_and_all_in_the_contents(run: tuple[Path, dict[str, Any], str]) -> None:
    outline = Outline(run[2])
    assert [section["id"] for section in outline.all("section")] == list(SECTIONS)
    assert [a["href"] for a in outline.all("a")[1 : 1 + len(SECTIONS)]] == [f"#{name}" for name in SECTIONS]
    assert "All 7 stages done in 8.75 s, 2 warnings" in outline.words


def test_every_warning_stands_on_the_page_with_its_stage(run: tuple[Path, dict[str, Any], str]) -> None:
    words = Outline(run[2]).words
    assert "merge : a pixel is lost" in words and "cluster : a light is uncertain" in words


def test_every_picture_has_an_alternative_text(run: tuple[Path, dict[str, Any], str]) -> None:
    outline = Outline(run[2])
    assert len(outline.all("img")) >= 10
    assert all((image["alt"] or "").strip() for image in outline.all("img"))
    assert all(figure.get("aria-label") for figure in outline.all("figure") if figure.get("role") == "img")


def test_every_picture_is_one_that_a_viewer_can_decode(run: tuple[Path, dict[str, Any], str]) -> None:
    for image in Outline(run[2]).all("img"):
        data = base64.b64decode((image["src"] or "").split(",", 1)[1], validate=True)
        assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None


def test_settings_that_differ_from_their_defaults_are_shown_and_no_others(
    run: tuple[Path, dict[str, Any], str],
) -> None:
    words = Outline(run[2]).words
    assert "merge.gain_e_per_dn 2.0 left out" in words and "working_space sRGB ITU-R BT.2020" in words
    assert "merge.defects" not in words


def test_figures_of_the_profile_lights_and_uplift_are_on_the_page(run: tuple[Path, dict[str, Any], str]) -> None:
    words = Outline(run[2]).words
    for figure in (
        "5.25",
        "patch 7",
        "2790 ± 60 K",
        "0.0012",
        "declare this lamp",
        "4.2e−9",
        "Example EX-1",
        "1/100 s",
        "0.5100",
    ):
        assert figure in words, figure


def test_the_unit_of_the_map_is_on_the_page(run: tuple[Path, dict[str, Any], str], tmp_path: Path) -> None:
    assert "<dt>Unit</dt><dd>relative</dd>" in run[2]
    records = finished_run(tmp_path)
    path = tmp_path / "panorama/environment.exr"
    unit = Unit(factor=1234.5, source="a <b>meter", likely=(0.85, 1.9))
    attributes = {**provenance.colour_space(SPACE), **unit_attributes(unit), "envmap": True}
    exr.write(path, exr.with_lost(room(missing=False)), attributes=attributes)
    write_report(tmp_path, records)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        "cd/m², from a &lt;b&gt;meter; the truth lies between 0.85 and 1.9 times that; what was 1 is 1234 cd/m²" in page
    )


def test_the_same_run_gives_the_same_bytes(run: tuple[Path, dict[str, Any], str], tmp_path: Path) -> None:
    output = tmp_path / "elsewhere"
    records = finished_run(output)
    write_report(output, {**records, "report": record(seconds=99.0)})
    assert (output / "report.html").read_text(encoding="utf-8") == run[2]


def test_names_of_strangers_cannot_become_markup(tmp_path: Path) -> None:
    records = finished_run(tmp_path, names=(HOSTILE, '"><img src=x onerror=alert(1)> $\\frac$ ランプ'))
    records["cluster"]["warnings"] = [HOSTILE, "{{ 7 * 7 }}"]
    records["merge"]["figures"]["shots"]["reference"]["frames"][0]["name"] = (
        "/home/somebody/shots/<img src=x onerror=alert(1)>"
    )
    records["merge"]["figures"]["shots"]["reference"]["camera"]["model"] = "</style><script>alert(1)</script>"
    records["merge"]["outputs"][f"../{HOSTILE}"] = HOSTILE
    records["merge"]["settings"] = {"working_space": HOSTILE}
    records["merge"]["summary"] = HOSTILE + "\udcff"
    write_report(tmp_path, records)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    outline = Outline(page)
    assert not outline.all("script") and len(outline.all("style")) == 1
    assert all(not name.startswith("on") for _, attributes in outline.elements for name in attributes)
    assert outline.words.count("alert(1)") >= 7
    assert "{{ 7 * 7 }}" in outline.words
    assert "somebody" not in page


def test_missing_pixels_are_hatched_and_explained(run: tuple[Path, dict[str, Any], str], tmp_path: Path) -> None:
    explained = "missing: clipped in every frame (NaN)"
    assert explained in Outline(run[2]).words
    write_report(tmp_path, finished_run(tmp_path, missing=False))
    assert explained not in Outline((tmp_path / "report.html").read_text(encoding="utf-8")).words


@pytest.mark.parametrize(
    ("last", "sections"),
    [
        ("merge", ["map", "warnings", "merge", "times"]),
        ("correct", ["map", "warnings", "merge", "chart", "shots", "times"]),
        ("balance", ["map", "warnings", "merge", "chart", "lamp", "shots", "times"]),
        ("cluster", ["map", "warnings", "merge", "chart", "lamp", "shots", "lights", "times"]),
        ("uplift", ["map", "warnings", "merge", "chart", "lamp", "shots", "lights", "uplift", "times"]),
    ],
)
def test_a_run_stopped_early_shows_what_is_there(tmp_path: Path, last: str, sections: list[str]) -> None:
    records = finished_run(tmp_path)
    names = list(records)
    shutil.rmtree(tmp_path / "mitsuba")
    for name in names[names.index(last) + 1 : -1]:
        shutil.rmtree(tmp_path / name)
        del records[name]
    outcome = write_report(tmp_path, records)
    outline = Outline((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert [section["id"] for section in outline.all("section")] == sections
    assert f"{names.index(last) + 1} of 7 stages done" in outline.words
    assert not outcome.warnings


def test_an_empty_folder_has_a_page_too(tmp_path: Path) -> None:
    write_report(tmp_path, {})
    assert "0 of 7 stages done" in Outline((tmp_path / "report.html").read_text(encoding="utf-8")).words


def test_stages_made_of_older_files_are_called_out_of_date(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    records["balance"]["outputs"] = {"balance/reference.exr": "9" * 64}
    write_report(tmp_path, records)
    words = Outline((tmp_path / "report.html").read_text(encoding="utf-8")).words
    assert words.count("out of date") == 4 and "3 of 7 stages done" in words
    assert "cluster : made from files that have changed since" in words


def test_a_damaged_file_is_left_out_with_a_warning(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    (tmp_path / "panorama/environment.exr").write_bytes(b"no image")
    (tmp_path / "cluster/lights.json").write_text("{", encoding="utf-8")
    outcome = write_report(tmp_path, records)
    damaged, no_image = outcome.warnings
    assert "lights.json: its lights are damaged" in damaged and "environment.exr: is not an OpenEXR file" in no_image
    outline = Outline((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "lights" not in [section["id"] for section in outline.all("section")]
    assert "is not an OpenEXR file" in outline.words and "4 warnings" in outline.words


def test_files_with_impossible_contents_are_left_out_with_a_warning(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    exr.write(tmp_path / "spectra/environment.exr", exr.rgb_planes(room()), attributes={})
    tampered = lights().model_copy(update={"wavelengths": "780:380:5"})
    (tmp_path / "cluster/lights.json").write_text(tampered.model_dump_json(), encoding="utf-8")
    profile = lamp_profile(chart_profile())
    far = profile.chart.model_copy(update={"corners": [(1e300, 0.0), (1e300, 1.0), (0.0, 1.0), (0.0, 0.0)]})
    profile.model_copy(update={"chart": far}).write(tmp_path / "balance/profile.json")
    outcome = write_report(tmp_path, records)
    assert len(outcome.warnings) == 2
    assert any("780:380:5" in text for text in outcome.warnings)
    assert any("holds no spectral band" in text for text in outcome.warnings)


def test_labels_beyond_all_lights_do_not_cost_memory(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    labels = np.full((HEIGHT, WIDTH), 2**32 - 1, np.uint32)
    planes = {**exr.rgb_planes(room()), "cluster": labels, "sky": labels * 0}
    exr.write(tmp_path / "cluster/clusters.exr", planes, attributes={})
    assert not write_report(tmp_path, records).warnings


def test_pixels_uplifted_under_d65_alone_are_not_given_a_lights_name(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    found = lights("desk lamp")
    labels = np.zeros((HEIGHT, WIDTH), np.uint32)
    _write_uplift(tmp_path / "uplift/environment.exr", room(), labels, found, method="scaled")
    write_report(tmp_path, records)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    titles = re.findall(r'aria-label="Spectra of two pixels: ([^"]*)"', page)
    assert titles == ["smooth spectrum of its colour temperature"]  # what the file calls its only emission


def test_a_damaged_record_is_refused_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(EnvcalError, match=r"run\.json: stages\.merge\.seconds: .* Run `envcal run` again\."):
        write_report(tmp_path, {"merge": {"seconds": "long"}})


def test_the_outcome_tells_what_the_page_shows_and_how_large_it_is(tmp_path: Path) -> None:
    outcome = write_report(tmp_path, finished_run(tmp_path))
    assert outcome.figures["bytes"] == (tmp_path / "report.html").stat().st_size
    assert outcome.figures["sections"] == [name for name in SECTIONS if name not in ("warnings", "times")]
    json.dumps(outcome.figures, allow_nan=False)


# ---- pictures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "width", "longest"), [(7, 13, 5), (64, 128, 64), (33, 70, 16), (5, 9, 100)])
def test_a_reduced_plane_equals_the_slow_loop_over_blocks(
    tmp_path: Path, height: int, width: int, longest: int
) -> None:
    rng = np.random.default_rng(1)
    plane = rng.uniform(0, 1, (height, width)).astype(np.float32)
    plane[rng.uniform(size=plane.shape) < 0.1] = np.nan
    labels = rng.integers(0, 5, plane.shape).astype(np.uint32)
    exr.write(tmp_path / "a.exr", {"R": plane, "status": labels}, attributes={})
    small = previews.reduced(tmp_path / "a.exr", {"R": "mean", "status": "max"}, longest=longest)
    step = small.step
    assert max(small.missing.shape) <= longest
    for y, x in np.ndindex(small.missing.shape):
        block = plane[y * step : (y + 1) * step, x * step : (x + 1) * step]
        seen = block[np.isfinite(block)].astype(np.float64)
        expected = seen.mean() if seen.size else np.nan
        np.testing.assert_allclose(small.planes["R"][y, x], expected, rtol=1e-6)
        assert small.missing[y, x] == np.isnan(block).any()
        assert small.planes["status"][y, x] == labels[y * step : (y + 1) * step, x * step : (x + 1) * step].max()


def test_reading_in_bands_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exr.write(tmp_path / "a.exr", exr.rgb_planes(room()), attributes={})
    whole = previews.reduced(tmp_path / "a.exr", dict.fromkeys("RGB", "mean"), longest=100)
    cut = previews.crop(tmp_path / "a.exr", (-20, 11, 30, 90), wrap=True)
    monkeypatch.setattr(previews, "_BAND_PIXELS", 1)
    np.testing.assert_array_equal(
        previews.reduced(tmp_path / "a.exr", dict.fromkeys("RGB", "mean"), longest=100).rgb, whole.rgb
    )
    np.testing.assert_array_equal(previews.crop(tmp_path / "a.exr", (-20, 11, 30, 90), wrap=True), cut)


def test_a_crop_goes_on_across_the_seam_of_a_map(tmp_path: Path) -> None:
    image = room()
    exr.write(tmp_path / "a.exr", exr.rgb_planes(image), attributes={})
    cut = previews.crop(tmp_path / "a.exr", (WIDTH - 3, 10, WIDTH + 4, 20), wrap=True)
    np.testing.assert_array_equal(cut, np.concatenate([image[10:20, -3:], image[10:20, :4]], axis=1))


def test_a_grey_below_the_knee_is_shown_by_the_srgb_curve_in_every_space() -> None:
    grey = np.full((2, 2, 3), 0.18, np.float32)
    expected = round(255 * (1.055 * 0.18 ** (1 / 2.4) - 0.055))
    # A level of 8 bits: the matrices between D65 spaces are exact to far less.
    for space in ("sRGB", "ITU-R BT.2020", "P3-D65"):
        shown = previews.display(grey, previews.srgb_matrix(space), gain=1.0)
        assert abs(shown.astype(int) - expected).max() <= 1, space


def test_brighter_is_never_shown_darker_nor_beyond_white() -> None:
    ramp = np.repeat(np.geomspace(1e-4, 1e6, 500, dtype=np.float32)[np.newaxis, :, np.newaxis], 3, axis=2)
    shown = previews.display(ramp, np.eye(3), gain=1.0)[0, :, 0].astype(int)
    assert (np.diff(shown) >= 0).all() and shown[0] == 0 and shown[-1] == 255


def test_exposure_does_not_depend_on_the_unit_of_the_picture() -> None:
    image = room()
    one, thousand = (previews.exposure(image * k, np.eye(3)) for k in (np.float32(1), np.float32(1024)))
    assert one == pytest.approx(1024 * thousand, rel=1e-5)


def test_a_picture_without_light_is_shown_black_rather_than_refused() -> None:
    black = np.zeros((4, 8, 3), np.float32)
    assert previews.display(black, np.eye(3), gain=previews.exposure(black, np.eye(3))).max() == 0
    assert previews.brightest_gain(np.full((4, 8, 3), np.nan, np.float32), np.eye(3)) == 1.0


def test_an_isotherm_stands_at_right_angles_to_the_locus_at_the_distance_asked() -> None:
    from uplift.cct import planckian_uv

    for cct in (2000.0, 4000.0, 12_000.0):
        centre, near, far = planckian_uv(cct), *planckian_uv(np.array([cct / 1.01, cct * 1.01]))
        above, below = plots.isotherm(cct, np.array([0.01, -0.01]))
        assert np.hypot(*(above - centre)) == pytest.approx(0.01, rel=1e-6)
        np.testing.assert_allclose(above + below, 2 * centre, atol=1e-9)
        assert above[1] > centre[1]
        cosine = (above - centre) @ (near - far) / (0.01 * np.hypot(*(near - far)))
        assert abs(cosine) < 0.01  # the locus bends a little within a per cent of temperature


# ---- in a browser ----------------------------------------------------------------------------------------------------


def in_browser(page: Path, folder: Path, *flags: str) -> tuple[str, set[str]]:
    """Open a page in headless Chromium; return its log and the addresses the page asked for.

    The browser asks for things of its own (updates, the time), which have no origin as their initiator.
    """
    assert BROWSER
    net_log = folder / "net.json"
    done = subprocess.run(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--disable-dev-shm-usage", f"--user-data-dir={folder / 'profile'}", "--enable-logging=stderr", "--v=0",
            f"--log-net-log={net_log}", *flags, page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    log = json.loads(net_log.read_text(encoding="utf-8"))
    kinds = {
        number for name, number in log["constants"]["logEventTypes"].items() if name.startswith("URL_REQUEST_START")
    }
    requests = [event.get("params", {}) for event in log["events"] if event["type"] in kinds]
    asked = {str(p["url"]) for p in requests if "url" in p and p.get("initiator") != "not an origin"}
    return done.stderr, asked


@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome in PATH")
def test_a_browser_opens_the_page_without_errors_and_asks_nobody(
    run: tuple[Path, dict[str, Any], str], tmp_path: Path
) -> None:
    picture = tmp_path / "page.png"
    log, asked = in_browser(run[0] / "report.html", tmp_path, "--window-size=1280,1600", f"--screenshot={picture}")
    assert "CONSOLE" not in log, log
    assert all(url.startswith(("file:", "data:")) for url in asked), asked
    shown = cv2.imread(str(picture))
    assert shown is not None and shown.shape[:2] == (1600, 1280)
    assert (
        len(np.unique(shown.reshape(-1, 3), axis=0)) > 1000
    )  # a blank page, or one without pictures, has a few colours


@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome in PATH")
def test_a_page_that_does_ask_or_complain_would_be_noticed(tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        "<meta charset=utf-8><script>console.error('told')</script><img src='http://127.0.0.1:9/x.png'>",
        encoding="utf-8",
    )
    log, asked = in_browser(page, tmp_path, "--dump-dom")
    assert "CONSOLE" in log and "http://127.0.0.1:9/x.png" in asked


def test_the_rendered_scene_is_shown_with_its_difference(run: tuple[Path, dict[str, Any], str]) -> None:
    outline = Outline(run[2])
    assert "mean 1.25, 95 % of the pixels below 3.50" in outline.words and "64 samples a pixel" in outline.words
    assert "rendered with another uplift file" not in outline.words
    shown = [a["alt"] for a in outline.all("img")]
    assert (
        "The scene lit by the spectra of the map" in shown and "The scene lit by the colours of the map alone" in shown
    )


def test_a_scene_rendered_with_another_uplift_file_is_pointed_out(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    _write_scene(tmp_path / "mitsuba", uplift="0" * 64)
    write_report(tmp_path, records)
    assert "rendered with another uplift file" in Outline((tmp_path / "report.html").read_text(encoding="utf-8")).words


def test_a_damaged_scene_is_left_out_with_a_warning(tmp_path: Path) -> None:
    records = finished_run(tmp_path)
    (tmp_path / "mitsuba/difference.png").write_bytes(b"no picture")
    outcome = write_report(tmp_path, records)
    assert any("difference.png: cannot be read" in text for text in outcome.warnings)
    (tmp_path / "mitsuba/figures.json").write_text("{}", encoding="utf-8")
    outcome = write_report(tmp_path, records)
    assert any("figures.json: is damaged" in text for text in outcome.warnings)
