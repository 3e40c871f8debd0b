"""A chart's own measured patches, from the files that instruments write."""

import numpy as np
import pytest

from calibrate.chart import chart_reference
from calibrate.difference import D65_XYZ
from envcal.errors import EnvcalError
from envcal.patches_file import D50_XYZ, read_patches
from samples.spectra import WAVELENGTHS_NM, chart_reflectances, cmfs, lamp

# Files hold four decimals; sums at 5 nm against sums at 10.
ROUNDING = 3e-4
STEPS = 2e-3


def published_under_d50():
    import colour

    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    return np.array([colour.xyY_to_XYZ(value) for value in chart.data.values()])


def cgats(names, rows):
    table = "\n".join(" ".join([f'"{k} x"', *(f"{v:.5f}" for v in row)]) for k, row in enumerate(rows, 1))
    return f"CTI3\n\nBEGIN_DATA_FORMAT\nSAMPLE_ID {' '.join(names)}\nEND_DATA_FORMAT\nBEGIN_DATA\n{table}\nEND_DATA\n"


def test_xyz_of_cgats_is_adapted_like_the_published_data(tmp_path):
    path = tmp_path / "mine.ti3"
    path.write_text(cgats(["XYZ_X", "XYZ_Y", "XYZ_Z"], 100 * published_under_d50()))
    read = read_patches(path)
    assert read.name == "mine.ti3"
    # The published white is (0.34570, 0.35850), ICC's D50 as instruments use it has four digits.
    np.testing.assert_allclose(read.XYZ, chart_reference().XYZ, atol=ROUNDING)


def test_lab_of_csv_is_the_same_as_xyz(tmp_path):
    import colour

    lab = colour.XYZ_to_Lab(published_under_d50(), colour.XYZ_to_xy(D50_XYZ))
    lines = ["name, L*, a*, b*", *(f"patch, {L:.5f}, {a:.5f}, {b:.5f}" for L, a, b in lab)]
    (tmp_path / "lab.csv").write_text("# measured\n" + "\n".join(lines))
    np.testing.assert_allclose(read_patches(tmp_path / "lab.csv").XYZ, chart_reference().XYZ, atol=2 * ROUNDING)


def test_reflectances_are_integrated_under_d65(tmp_path):
    every = slice(0, -10, 2)
    bands = [f"SPEC_{nm:.0f}" for nm in WAVELENGTHS_NM[every]]
    path = tmp_path / "spectra.txt"
    path.write_text(cgats(bands, 100 * chart_reflectances()[:, every]))
    expected = chart_reflectances() * lamp("D65") @ cmfs() / (lamp("D65") @ cmfs()[:, 1])
    np.testing.assert_allclose(read_patches(path).XYZ, expected * (D65_XYZ / D65_XYZ), atol=STEPS)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (cgats(["XYZ_X", "XYZ_Y", "XYZ_Z"], np.ones((23, 3))), "holds 23 patches"),
        (cgats(["CMYK_C", "CMYK_M", "CMYK_Y"], np.ones((24, 3))), "its columns are"),
        (cgats(["XYZ_X", "XYZ_Y", "XYZ_Z"], np.full((24, 3), 20.0)), "expected the 19th, white"),
        ("X,Y,Z\n1,2,three\n", "patch 1 has no number"),
        ("BEGIN_DATA_FORMAT\nA\nEND_DATA_FORMAT", "no BEGIN_DATA"),
        ("", "is empty"),
    ],
)
def test_what_is_no_list_of_patches_is_refused_with_the_file(tmp_path, text, expected):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(EnvcalError, match=expected):
        read_patches(path)
    with pytest.raises(EnvcalError, match="cannot be read"):
        read_patches(tmp_path / "missing.csv")


def sg_rows(order, *, names, spectra=False):
    """A CGATS file of an SG in the order of `order`, its patches called by `names`."""
    import colour

    chart = colour.CCS_COLOURCHECKERS["ColorCheckerSG - After November 2014"].data
    rows = {name: 100 * colour.xyY_to_XYZ(value) for name, value in chart.items()}
    columns = ["XYZ_X", "XYZ_Y", "XYZ_Z"]
    if spectra:
        columns = [f"SPEC_{nm}" for nm in range(380, 731, 10)]
        # Grey surfaces of the right brightness: enough to follow them through the files.
        rows = {name: np.full(36, xyz[1]) for name, xyz in rows.items()}
    lines = [" ".join([names(name), *(f"{v:.5f}" for v in rows[name])]) for name in order]
    head = f"CGATS.17\nBEGIN_DATA_FORMAT\nSAMPLE_NAME {' '.join(columns)}\nEND_DATA_FORMAT\nBEGIN_DATA\n"
    return head + "\n".join(lines) + "\nEND_DATA\n"


BY_ROWS = [f"{column}{row}" for row in range(1, 11) for column in "ABCDEFGHIJKLMN"]
BY_COLUMNS = sorted(BY_ROWS, key=lambda name: (name[0], int(name[1:])))


@pytest.mark.parametrize("order", [BY_ROWS, BY_COLUMNS], ids=["by rows", "by columns"])
@pytest.mark.parametrize("names", [str, lambda name: f"{name[0].lower()}{int(name[1:]):02d}"], ids=["A1", "a01"])
def test_the_patches_of_an_sg_are_told_by_their_names_in_any_order(tmp_path, order, names):
    (tmp_path / "sg.txt").write_text(sg_rows(order, names=names))
    read = read_patches(tmp_path / "sg.txt")
    sg = chart_reference("ColorCheckerSG - After November 2014")
    np.testing.assert_allclose(read.XYZ, sg.XYZ, atol=ROUNDING)
    assert read.layout == sg.layout and read.names == sg.names and read.reflectances is None


def test_an_sg_without_the_names_of_its_patches_is_refused(tmp_path):
    (tmp_path / "sg.txt").write_text(sg_rows(BY_ROWS, names=lambda name: f"{BY_ROWS.index(name) + 1}"))
    with pytest.raises(EnvcalError, match=r"no patch is called A1, B1, C1, D1 ….*SAMPLE_NAME"):
        read_patches(tmp_path / "sg.txt")


def test_reflectances_are_kept_for_the_light_on_the_chart(tmp_path):
    (tmp_path / "sg.txt").write_text(sg_rows(BY_COLUMNS, names=str, spectra=True))
    read = read_patches(tmp_path / "sg.txt")
    assert read.reflectances.shape == (140, 36)
    np.testing.assert_array_equal(read.wavelengths_nm, np.arange(380, 731, 10))
    np.testing.assert_allclose(read.reflectances[:, 0], read.XYZ[:, 1], atol=STEPS)
