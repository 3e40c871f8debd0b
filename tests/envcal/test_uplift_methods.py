"""Every method from the map to its bands: the bands give back the map, and what is not exact is told apart."""

import ast
import base64
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, provenance, uplift_file
from envcal.cli import main
from envcal.errors import EnvcalError
from envcal.steps import spectra as spectra_step
from envcal.steps import uplift as uplift_step
from uplift.difference import delta_e_2000
from uplift.pixels import Status
from uplift.spectrum import observer, rgb_space

ROOT = Path(__file__).parents[2]
METHODS = ("constrained", "scaled", "lattice")
HEIGHT, WIDTH = 16, 32
SPACE = "sRGB"
#: ΔE2000 that coefficients, or weights and bands, may cost when rounded to float32 (the page of the uplift file says it).
AS_STORED = 1e-2
#: Rounding of float32 bands, and nothing else.
FLOAT32 = 2e-7


def envcal(*arguments):
    done = CliRunner().invoke(main, [str(a) for a in arguments])
    assert done.exit_code == 0, done.output
    return done


def colours():
    """A warm map with a black, a missing, a negative, a dark blue and a bright blue pixel."""
    rgb = np.random.default_rng(3).uniform(0.15, 0.45, (HEIGHT, WIDTH, 3)) * [1.6, 1.0, 0.5]
    rgb[0, 0] = 0.0
    rgb[8, 9] = np.nan
    rgb[7, 3] = [-1.0, -1.0, -2.0]
    rgb[5, 5] = [0.002, 0.01, 0.3]
    rgb[5, 6] = [0.2, 1.0, 30.0]
    return rgb.astype(np.float32)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("methods")
    rgb = colours()
    exr.write(folder / "map.exr", exr.rgb_planes(rgb), attributes={**provenance.colour_space(SPACE), "envmap": True})
    (folder / "lights.yaml").write_text("lights: [{at: [0.5, 0.5], type: incandescent, cct: 2400}]")
    envcal("cluster", folder / "map.exr", "-o", folder / "clusters.exr", "--lights", folder / "lights.yaml")
    figures = {}
    for method in METHODS:
        up, bands = folder / f"{method}.exr", folder / f"{method}.bands.exr"
        told = envcal(
            "uplift", folder / "map.exr", "-o", up, "--clusters", folder / "clusters.exr", "--method", method, "--json"
        )
        figures[method] = json.loads(told.stdout)
        envcal("spectra", up, "-o", bands)
    return folder, rgb, figures


def bands_of(path):
    header = exr.header(path)
    names = sorted(name for name in header.channels if name.startswith("S0."))
    _, planes = exr.read(path, names)
    return np.stack([planes[name] for name in names], axis=-1)


@pytest.mark.parametrize("method", METHODS)
def test_the_bands_integrate_to_the_colours_that_the_method_keeps(files, method):
    folder, rgb, _ = files
    spectra = bands_of(folder / f"{method}.bands.exr").astype(np.float64)
    seen, space = observer(), rgb_space(SPACE)
    back = spectra @ seen.cmfs * seen.step_nm @ space.rgb_from_xyz.T
    _, planes = exr.read(folder / f"{method}.exr", ["status"])
    kept = np.isin(planes["status"], (Status.EXACT, Status.FALLBACK))
    assert kept.mean() > 0.7
    assert delta_e_2000(rgb[kept].astype(np.float64), back[kept], space).max() < AS_STORED
    assert spectra.min() >= 0
    assert not spectra[~np.isfinite(rgb).all(axis=2) | ~rgb.any(axis=2)].any()


@pytest.mark.parametrize("method", METHODS)
def test_figures_count_every_pixel_once_and_tell_its_share_of_the_sphere(files, method):
    folder, _, told = files
    figures = told[method]["figures"]
    _, planes = exr.read(folder / f"{method}.exr", ["status"])
    weights = np.broadcast_to(np.sin(np.pi * (np.arange(HEIGHT) + 0.5) / HEIGHT)[:, None], (HEIGHT, WIDTH))
    for status in Status:
        here = planes["status"] == status
        assert figures["status"][status.name.lower()] == here.sum()
        assert figures["solid_angle"][status.name.lower()] == pytest.approx(weights[here].sum() / weights.sum())
    assert figures["status"]["missing"] == figures["status"]["black"] == 1
    # A pixel at the pole is smaller than one at the horizon.
    assert figures["solid_angle"]["black"] < 0.2 * figures["solid_angle"]["missing"]
    errors = figures["delta_e_by_status"]
    assert errors["exact"]["max"] < 1e-9
    assert errors["fallback"]["max"] < 1e-9
    assert figures["round_trip_delta_e"]["max"] == max(errors["exact"]["max"], errors["fallback"]["max"])
    assert errors["closest"]["max"] == figures["largest_shift_delta_e"] > 1
    assert errors["closest"]["mean"] <= errors["closest"]["max"]


def test_the_lattice_does_with_blue_under_a_warm_lamp_what_the_paper_does(files):
    folder, _, told = files
    _, planes = exr.read(folder / "lattice.exr", ["status", "cluster", "u", "v", "w", "cell", "scale"])
    assert planes["status"][5, 5] == Status.FALLBACK and planes["cluster"][5, 5] == 1
    assert planes["status"][5, 6] == Status.CLOSEST and planes["cluster"][5, 6] == 0
    assert planes["scale"][0, 0] == planes["scale"][8, 9] == 0
    assert np.isfinite(planes["u"]).all()
    warnings = " ".join(told["lattice"]["warnings"])
    assert "their colour is kept in that of D65" in warnings
    assert "given its nearest colour" in warnings
    assert "moved by ΔE2000" in warnings
    assert told["lattice"]["figures"]["cells_visited"] >= 1


def test_the_lattice_asks_less_of_its_floats_than_coefficients_do(files):
    told = files[2]
    assert told["lattice"]["figures"]["round_trip_delta_e_stored"]["max"] < 1e-5


def test_three_methods_give_three_spectra_of_one_colour(files):
    folder = files[0]
    spectra = {method: bands_of(folder / f"{method}.bands.exr")[10, 10] for method in METHODS}
    for one, other in (("constrained", "scaled"), ("constrained", "lattice"), ("scaled", "lattice")):
        assert np.abs(spectra[one] / spectra[other] - 1).max() > 1e-3


def taken_from(path):
    """(module, name) of everything that a module of `uplift` takes from others of it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("uplift"):
            yield from ((node.module, alias.name) for alias in node.names)
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.startswith("uplift"))


def test_the_baselines_share_no_solver_and_no_table_with_the_exact_path():
    # What a status is called, the record that counts what came out, and what all colour rests on.
    names = {"Status", "Uplifted", "UpliftError", "recorded"}
    common = {"uplift.spectrum", "uplift.difference"}
    for path in [ROOT / "uplift" / "scaled.py", *(ROOT / "uplift" / "lattice").glob("*.py")]:
        for module, name in taken_from(path):
            assert name in names or module in common or module.startswith("uplift.lattice"), (path.name, module, name)


@pytest.mark.parametrize("method", METHODS)
def test_tiles_make_no_difference(files, method, tmp_path, monkeypatch):
    folder = files[0]
    monkeypatch.setattr(uplift_step, "TILE_PIXELS", 3 * WIDTH)
    monkeypatch.setattr(spectra_step, "TILE_SAMPLES", 5 * WIDTH * 81)
    up = tmp_path / "up.exr"
    told = envcal(
        "uplift", folder / "map.exr", "-o", up, "--clusters", folder / "clusters.exr", "--method", method, "--json"
    )
    envcal("spectra", up, "-o", tmp_path / "bands.exr")
    names = [name for name in exr.header(up).channels if name not in "RGB"]
    (_, whole), (_, tiled) = exr.read(folder / f"{method}.exr", names), exr.read(up, names)
    for name in names:
        np.testing.assert_array_equal(tiled[name], whole[name], err_msg=name)
    np.testing.assert_array_equal(bands_of(tmp_path / "bands.exr"), bands_of(folder / f"{method}.bands.exr"))
    figures, before = json.loads(told.stdout)["figures"], files[2][method]["figures"]
    assert figures["status"] == before["status"]
    assert figures["solid_angle"] == pytest.approx(before["solid_angle"])


def test_the_lattice_of_the_file_is_the_lattice_that_was_solved(files):
    from uplift.lattice import build_cube

    _, about = uplift_file.read_any_about(files[0] / "lattice.exr")
    cube, solved = about.lattice_cube(), build_cube(observer=observer(), space=rgb_space(SPACE))
    np.testing.assert_array_equal(cube.coefficients, np.where(solved.filled[..., None], solved.coefficients, 0))
    np.testing.assert_array_equal(cube.filled, solved.filled)
    np.testing.assert_allclose(cube.t, solved.t, rtol=0, atol=FLOAT32)


def test_who_needs_coefficients_refuses_a_lattice_and_says_how_to_get_them(files):
    with pytest.raises(EnvcalError, match=r"mixture of eight spectra.*--method constrained.*envcal spectra"):
        uplift_file.read_about(files[0] / "lattice.exr")
    assert not {"c0", "c1", "c2"} & set(exr.header(files[0] / "lattice.exr").channels)
    assert uplift_file.read_about(files[0] / "scaled.exr")[1].method == "scaled"


def rewritten(files, tmp_path, *, change=None, planes=None):
    """A copy of the lattice's file with another header or other planes."""
    header = exr.header(files[0] / "lattice.exr")
    _, found = exr.read(files[0] / "lattice.exr", list(header.channels))
    about = header.json(uplift_file.ATTRIBUTE)
    (change or (lambda _: None))(about)
    path = tmp_path / "changed.exr"
    exr.write(path, {**found, **(planes(found) if planes else {})}, attributes={uplift_file.ATTRIBUTE: about})
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda about: about.update(format=3), "has the format 3, and this version of envcal reads 1 and 2"),
        (lambda about: about.pop("cube"), "is damaged"),
        (lambda about: about["cube"].update(coefficients="???"), "are no base64"),
        (lambda about: about["cube"].update(coefficients=base64.b64encode(b"12345678").decode()), "bytes of nodes"),
        (lambda about: about["cube"].update(size=100000), "is damaged"),
        (lambda about: about["clusters"].pop(), "names an emission it does not hold"),
        (lambda about: about.update(format=1), "is damaged"),
    ],
)
def test_a_lattice_that_was_tampered_with_is_refused(files, tmp_path, change, said):
    path = rewritten(files, tmp_path, change=change)
    done = CliRunner().invoke(main, ["spectra", str(path), "-o", str(tmp_path / "out.exr")])
    assert done.exit_code == 1
    assert said in done.output
    assert "Traceback" not in done.output
    assert not (tmp_path / "out.exr").exists()


def test_a_cell_that_is_not_there_is_refused(files, tmp_path):
    path = rewritten(files, tmp_path, planes=lambda found: {"cell": np.full_like(found["cell"], 31**3)})
    done = CliRunner().invoke(main, ["spectra", str(path), "-o", str(tmp_path / "out.exr")])
    assert done.exit_code == 1
    assert "names a cell its lattice does not have" in done.output


def test_a_setting_of_the_pipeline_chooses_the_lattice(tmp_path):
    from envcal.config import Pipeline

    settings = Pipeline.model_validate({"capture": {"reference": "a.dng"}, "uplift": {"method": "lattice"}})
    assert settings.uplift.method == "lattice"


@pytest.mark.parametrize("method", METHODS)
def test_the_page_tells_each_methods_pixels_apart(files, method, tmp_path):
    from envcal.report import write_report

    (tmp_path / "uplift").mkdir()
    shutil.copy(files[0] / f"{method}.exr", tmp_path / "uplift" / "environment.exr")
    told = files[2][method]
    record = {"seconds": 1.0, "figures": told["figures"], "warnings": told["warnings"]}
    outcome = write_report(tmp_path, {"uplift": record})
    assert not outcome.warnings
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = {
        cells[0]: cells[1:]
        for row in re.findall(r"<tr>(.*?)</tr>", page)
        if len(cells := [re.sub(r"<[^>]+>", "", cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)]) == 6
    }
    figures = told["figures"]
    for status in Status:
        name = status.name.lower()
        count, _, sphere, error, _ = rows[name]
        assert int(count.replace("\u202f", "").replace(" ", "").replace("\xa0", "")) == figures["status"][name]
        share = 100 * figures["solid_angle"][name]
        assert sphere == ("< 0.01 %" if 0 < share < 0.01 else f"{share:.2f} %")
        told_error = name in figures["delta_e_by_status"] and figures["status"][name] > 0
        assert (error != "–") == told_error
    assert ("mixture of eight" in page) == (method == "lattice")
    assert "Spectra of two pixels" in page


# ---- what reads the file further on ----


def test_a_lattice_is_refused_by_every_renderers_files_and_a_scaled_uplift_is_taken(files, tmp_path):
    folder, said = files[0], r"mixture of eight spectra.*--method constrained"
    for name, more in {"mitsuba": ["--no-render"], "rgb": [], "pbrt": [], "basis": []}.items():
        command = [name] if name == "mitsuba" else ["export", "--to", name]
        done = CliRunner().invoke(main, [*command, str(folder / "lattice.exr"), "-o", str(tmp_path / name), *more])
        assert done.exit_code == 1 and re.search(said, done.output, re.DOTALL), (name, done.output)
        assert not (tmp_path / name).exists() or not list((tmp_path / name).iterdir()), name
        envcal(*command, folder / "scaled.exr", "-o", tmp_path / f"{name}_scaled", *more)


def test_the_rgb_of_a_scaled_uplift_are_the_colours_that_it_keeps(files, tmp_path):
    folder, rgb, _ = files
    envcal("export", "--to", "rgb", folder / "scaled.exr", "-o", tmp_path, "--space", "sRGB")
    _, found = exr.read_rgb(tmp_path / "environment_srgb.exr")
    _, planes = exr.read(folder / "scaled.exr", ["status"])
    kept = planes["status"] == Status.EXACT
    assert kept.mean() > 0.9
    np.testing.assert_allclose(found[kept], rgb[kept], rtol=1e-3, atol=1e-5)


def test_the_emitter_shines_with_the_bands_of_a_scaled_uplift_and_refuses_a_lattice(files):
    mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")
    from envcal.mitsuba import set_variant

    folder = files[0]
    set_variant("scalar_spectral")
    with pytest.raises((EnvcalError, RuntimeError), match="mixture of eight spectra"):
        mi.load_dict({"type": "envcal", "filename": str(folder / "lattice.exr")})
    emitter = mi.load_dict({"type": "envcal", "filename": str(folder / "scaled.exr")})
    bands = bands_of(folder / "scaled.bands.exr")
    for row, column in ((3, 4), (9, 20), (5, 6), (12, 31)):
        phi, theta = 2 * np.pi * (column + 0.5) / WIDTH, np.pi * (row + 0.5) / HEIGHT
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(-np.sin(phi) * np.sin(theta), -np.cos(theta), np.cos(phi) * np.sin(theta))
        si.wavelengths = mi.Spectrum(420.0, 500.0, 580.0, 660.0)
        expected = bands[row, column, [8, 24, 40, 56]]
        # The light of a texel's centre, where a rounded direction still takes 1e-5 of its neighbours.
        np.testing.assert_allclose(
            np.array(emitter.eval(si)) * mi.MI_CIE_Y_NORMALIZATION, expected, rtol=2e-3, err_msg=f"{row}, {column}"
        )
