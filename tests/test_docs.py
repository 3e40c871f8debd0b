"""The documentation says what the code does: its links, commands, fields and examples are checked against it."""

import importlib.util
import json
import re
import runpy
import shlex
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, lights_file, profile, provenance, spectral_exr, uplift_file
from envcal.cli import main
from envcal.config import Pipeline
from envcal.stages import STAGES
from envcal.unit import Unit
from uplift.pixels import Status
from uplift.radiance import spectra_of
from uplift.spectrum import observer, rgb_space

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
#: The same formula in float64 twice; ½ + x/(2√(1 + x²)) loses digits where R is small, which the package avoids.
SAME_FORMULA = 1e-9
#: What a float32 keeps.
FLOAT32 = 1e-7
#: float32 pixels through two 3×3 matrices one after the other, against their product in float64.
FLOAT32_TWICE = 1e-6


def text_of(page):
    return page.read_text(encoding="utf-8")


def names(pages):
    return [page.relative_to(ROOT).as_posix() for page in pages]


def every_page(test):
    return pytest.mark.parametrize("page", PAGES, ids=names(PAGES))(test)


def every_stage(test):
    return pytest.mark.parametrize("stage", STAGES, ids=[stage.name for stage in STAGES])(test)


def stage_page(stage):
    return DOCS / "stages" / f"{stage.name}.md"


def python_blocks(page):
    return re.findall(r"^```python\n(.*?)^```$", text_of(page), flags=re.MULTILINE | re.DOTALL)


def run_example(page, folder, monkeypatch, number=0, of=1, most_lines=16):
    """Run a Python example of a page in `folder`, and return what it leaves."""
    blocks = python_blocks(page)
    assert len(blocks) == of
    source = blocks[number]
    assert len([line for line in source.splitlines() if line.strip()]) <= most_lines
    script = folder / "example.py"
    script.write_text(source, encoding="utf-8")
    monkeypatch.chdir(folder)
    return runpy.run_path(str(script))


# ---- the pages themselves ----


def test_the_page_of_the_settings_is_what_the_code_says():
    spec = importlib.util.spec_from_file_location("settings_page", DOCS / "settings.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert text_of(DOCS / "settings.md") == module.page(), "run `python docs/settings.py`"


def test_the_page_of_the_settings_has_a_row_for_every_setting():
    page = text_of(DOCS / "settings.md")
    for name, field in Pipeline.model_fields.items():
        parts = getattr(field.annotation, "model_fields", None)
        rows = [name] if parts is None else [f"{name}.{inner}" for inner in parts]
        assert all(f"| `{row}` |" in page for row in rows)


@every_page
def test_every_relative_link_points_to_a_file_and_a_heading_that_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", text_of(page)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", text_of(file), flags=re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}
            assert anchor in slugs, f"{page.name}: {target}"


@every_page
def test_every_command_line_is_one_that_the_program_takes(page):
    """Lines of code are parsed as click would before it starts to work; words in running text name commands."""
    text = re.sub(r"^```.*?^```$", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^ {4,}(?:.*&& )?(?:uv run (?:--no-sync )?)?envcal (.+)$", text, flags=re.MULTILINE)
    inline = re.findall(r"`(?:uv run (?:--no-sync )?)?envcal ([a-z][^`]*)`", text)
    for line in [*lines, *inline]:
        name, *arguments = shlex.split(line, comments=True)
        assert name in main.commands, f"{page.name}: envcal {line}"
        command = main.commands[name]
        known = {option for parameter in command.params for option in parameter.opts}
        assert {a for a in arguments if a.startswith("-")} <= known, f"{page.name}: envcal {line}"
        if line in lines:
            try:
                command.make_context(name, list(arguments))
            except click.ClickException as error:
                pytest.fail(f"{page.name}: envcal {line}: {error.format_message()}")


def test_a_command_line_that_is_wrong_would_be_noticed():
    with pytest.raises(click.ClickException):
        main.commands["merge"].make_context("merge", ["frame.dng"])


def test_every_pipeline_file_shown_is_one_that_the_program_takes():
    from ruamel.yaml import YAML

    shown = [block for page in PAGES for block in re.findall(r"^```yaml\n(.*?)^```$", text_of(page), re.M | re.S)]
    assert shown
    for block in shown:
        Pipeline.model_validate(YAML(typ="safe").load(block))


# ---- stages ----


@every_stage
def test_every_stage_has_a_page_of_one_screen_or_two(stage):
    text = text_of(stage_page(stage))
    assert text.startswith(f"# {stage.name}: ")
    assert len(text.splitlines()) <= 80
    for heading in ("## Method", "## Settings", "## Warnings", "## Refusals", "## What it does not do"):
        assert heading in text


@every_stage
def test_the_page_of_a_stage_names_its_files_and_settings(stage):
    text = text_of(stage_page(stage))
    for output in stage.outputs:
        assert output.replace("{shot}", "SHOT").rsplit("/", 1)[-1] in text
        if output.endswith(".exr"):
            assert output.replace("{shot}", "SHOT") in text
    for name in stage.settings:
        parts = getattr(Pipeline.model_fields[name].annotation, "model_fields", None)
        for setting in [name] if parts is None else [f"{name}.{inner}" for inner in parts]:
            assert f"`{setting}`" in text


def test_every_page_of_a_stage_is_in_the_index():
    index = text_of(DOCS / "README.md")
    assert {path.stem for path in (DOCS / "stages").glob("*.md")} == {stage.name for stage in STAGES}
    assert all(f"(stages/{stage.name}.md)" in index for stage in STAGES)


# ---- formats ----


@pytest.mark.parametrize(
    ("page", "models"),
    [
        ("profile.md", (profile.Profile, profile.Camera, profile.Chart, profile.Patch, profile.Lamp, Unit)),
        (
            "uplift-file.md",
            (uplift_file.About, uplift_file.LatticeAbout, uplift_file.CubeRecord, uplift_file.Emission),
        ),
        ("stages/cluster.md", (lights_file.Lights, lights_file.LightRecord)),
    ],
)
def test_every_field_of_a_format_is_described(page, models):
    text = text_of(DOCS / page)
    missing = {name for model in models for name in model.model_fields if f"`{name}`" not in text}
    assert not missing


def test_every_channel_and_status_of_the_uplift_file_is_described():
    text = text_of(DOCS / "uplift-file.md")
    assert all(f"`{name}`" in text for name in uplift_file.CHANNELS | uplift_file.LATTICE_CHANNELS)
    assert all(f"{status.value} {status.name.lower()}" in text for status in Status)


def tiny_map(path):
    """A lat-long map of colours under a warm light, with a black and a missing pixel."""
    rgb = np.random.default_rng(7).uniform(0.05, 1.0, (8, 16, 3)) * [1.4, 1.0, 0.6]
    rgb[0, 0] = 0.0
    rgb[4, 9] = np.nan
    attributes = {**provenance.colour_space("sRGB"), "envmap": True}
    exr.write(path, exr.rgb_planes(rgb.astype(np.float32)), attributes=attributes)


def test_a_stranger_reads_the_radiance_of_an_uplift_file_with_the_example(tmp_path, monkeypatch):
    tiny_map(tmp_path / "map.exr")
    target = tmp_path / "uplift.exr"
    done = CliRunner().invoke(main, ["uplift", str(tmp_path / "map.exr"), "-o", str(target), "--indoor", "led"])
    assert done.exit_code == 0, done.output
    left = run_example(DOCS / "uplift-file.md", tmp_path, monkeypatch, of=2)
    radiance, planes, about = left["radiance"], left["planes"], left["about"]
    emissions = np.array([cluster["emission"] for cluster in about["clusters"]])
    coefficients = np.stack([planes[f"c{k}"] for k in range(3)], axis=-1)
    own = spectra_of(coefficients, planes["scale"], planes["cluster"], emissions, [550.0])[..., 0]
    assert radiance.shape == (8, 16)
    np.testing.assert_allclose(radiance, own, rtol=SAME_FORMULA, atol=0)
    # What the page says of black and missing pixels.
    assert radiance[0, 0] == radiance[4, 9] == 0
    assert planes["status"][0, 0] == Status.BLACK
    assert planes["status"][4, 9] == Status.MISSING
    assert np.isnan(planes["R"][4, 9])
    assert not coefficients[planes["scale"] == 0].any()
    assert about["clusters"][-1]["type"] == "fallback"
    assert about["status"] == {str(s.value): s.name.lower() for s in Status}


def test_a_stranger_reads_the_radiance_of_a_lattice_with_the_other_example(tmp_path, monkeypatch):
    tiny_map(tmp_path / "map.exr")
    target = tmp_path / "lattice.exr"
    up = ["uplift", str(tmp_path / "map.exr"), "-o", str(target), "--indoor", "led", "--method", "lattice"]
    bands = ["spectra", str(target), "-o", str(tmp_path / "bands.exr"), "--wavelengths", "545:555:5"]
    for arguments in (up, bands):
        done = CliRunner().invoke(main, arguments)
        assert done.exit_code == 0, done.output
    left = run_example(DOCS / "uplift-file.md", tmp_path, monkeypatch, number=1, of=2, most_lines=20)
    name = spectral_exr.channel(550)
    _, planes = exr.read(tmp_path / "bands.exr", [name])
    assert left["radiance"].shape == (8, 16)
    assert left["radiance"][0, 0] == left["radiance"][4, 9] == 0
    assert (left["radiance"] > 0).sum() == 126
    np.testing.assert_allclose(left["radiance"], planes[name], rtol=FLOAT32, atol=0)
    assert left["about"]["format"] == 2
    assert "c0" not in left["planes"]


def test_every_emission_of_an_uplift_file_has_the_luminance_that_the_page_says(tmp_path):
    tiny_map(tmp_path / "map.exr")
    target = tmp_path / "uplift.exr"
    done = CliRunner().invoke(main, ["uplift", str(tmp_path / "map.exr"), "-o", str(target), "--method", "scaled"])
    assert done.exit_code == 0, done.output
    about = exr.header(target).json(uplift_file.ATTRIBUTE)
    seen = observer()
    assert about["wavelengths_nm"] == seen.wavelengths_nm.tolist()
    for cluster in about["clusters"]:
        assert np.sum(seen.cmfs[:, 1] * cluster["emission"]) * seen.step_nm == pytest.approx(1, rel=1e-12)


def made_up_profile():
    patch = profile.Patch(
        name="dark skin",
        camera_rgb=(0.1, 0.2, 0.1),
        noise=(0.001, 0.001, 0.001),
        pixels=9,
        light=1.0,
        target_rgb=(0.2, 0.1, 0.1),
        fitted_rgb=(0.2, 0.1, 0.1),
        delta_e=1.0,
        delta_e_left_out=1.0,
    )
    chart = profile.Chart(
        reference="ColorChecker24 - After November 2014",
        found="settings",
        corners=[(1, 1), (9, 1), (9, 6), (1, 6)],
        quads=[],
        score=None,
        fit="linear",
        patches=[patch],
    )
    lamp = profile.Lamp(
        found="settings",
        polygon=[(10, 1), (11, 1), (11, 2)],
        pixels=9,
        clipped=0,
        rgb=(1.6, 1.9, 2.4),
        noise=(0.001, 0.001, 0.001),
        transform="CAT16",
        luminance="lamp",
        cone_gains=(0.55, 0.52, 0.41),
    )
    return profile.Profile(
        working_space="ITU-R BT.2020",
        camera=profile.Camera(model="camera", lens="lens", iso=100, f_number=8),
        reference_shot="reference.exr",
        reference_digest="0" * 64,
        chart=chart,
        matrix=((0.5, -0.04, -0.01), (-0.02, 0.4, -0.1), (0.02, -0.08, 0.5)),
        lamp=lamp,
        balance_matrix=((0.55, 0.04, 0.005), (-0.006, 0.5, 0.01), (-0.001, -0.007, 0.4)),
    )


def test_a_profile_applied_by_hand_gives_what_the_commands_give(tmp_path, monkeypatch):
    made = made_up_profile()
    made.write(tmp_path / "balanced.profile.json")
    left = run_example(DOCS / "profile.md", tmp_path, monkeypatch)
    attributes = {
        "envcalStage": "merge",
        "envcalSpace": provenance.CAMERA_RGB,
        "envcalCamera": json.loads(made.camera.model_dump_json()),
    }
    exr.write(tmp_path / "merged.exr", exr.rgb_planes(left["camera_rgb"]), attributes=attributes)
    for line in ("correct merged.exr -o corrected.exr", "balance corrected.exr -o balanced.exr"):
        done = CliRunner().invoke(main, [*line.split(), "--profile", "balanced.profile.json"])
        assert done.exit_code == 0, done.output
    _, balanced = exr.read_rgb(tmp_path / "balanced.exr")
    np.testing.assert_allclose(left["balanced"], balanced, rtol=0, atol=FLOAT32_TWICE)


def test_the_uplift_stands_alone_as_the_page_of_its_functions_shows(tmp_path, monkeypatch):
    blocks = python_blocks(DOCS / "api.md")
    (tmp_path / "notebook.py").write_text("\n".join(blocks), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    left = runpy.run_path(str(tmp_path / "notebook.py"))
    found, seen, rgb = left["found"], left["seen"], left["rgb"]
    # Tiles in memory that is used again, in preview: a scale differs by less than a just noticeable difference.
    assert left["brightest"] == pytest.approx(found.scale.max(), rel=0.01)
    # What is exact under one of the lights comes back; nothing here is moved.
    assert set(np.unique(found.status)) <= {Status.EXACT, Status.FALLBACK}
    np.testing.assert_allclose(left["back"], rgb, rtol=0, atol=1e-9)
    np.testing.assert_allclose(left["xyz"][..., 1], rgb @ rgb_space("sRGB").luminance_weights, rtol=1e-9)
    # The bands on disk are samples of the spectra, and a ray in the middle of a texel sees one of them.
    whole = (found.coefficients, found.scale, found.emission, found.emissions)
    np.testing.assert_array_equal(left["at_550"], spectra_of(*whole, np.array([500.0, 550.0]), observer=seen)[..., 1])
    bands = spectra_of(*whole, left["bands_nm"], observer=seen)
    np.testing.assert_allclose(np.load(tmp_path / "bands.npy"), bands, rtol=FLOAT32)
    rays, wavelengths = left["seen_by_ray"], left["wavelengths_nm"]
    for ray in range(0, 1000, 97):
        column, row = left["column"][ray], left["row"][ray]
        corners = spectra_of(*whole, wavelengths[ray], observer=seen)[row : row + 2][:, [column, (column + 1) % 8]]
        assert (corners.min(axis=(0, 1)) <= rays[ray] * (1 + SAME_FORMULA)).all()
        assert (rays[ray] <= corners.max(axis=(0, 1)) * (1 + SAME_FORMULA)).all()


def test_the_page_of_the_functions_names_what_exists():
    import importlib

    for module, name in re.findall(r"`([a-z]+)\.([a-z_0-9]+)(?=[(`])", text_of(DOCS / "api.md")):
        if module not in ("uplift", "space"):
            assert hasattr(importlib.import_module(f"uplift.{module}"), name), f"{module}.{name}"
