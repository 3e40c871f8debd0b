"""The uplift file of a map whose pixels two lights share."""

import numpy as np
import pytest

from envcal import exr, provenance
from envcal.config import UpliftSettings
from envcal.errors import EnvcalError
from envcal.maps import read_map
from envcal.steps.uplift import uplift
from envcal.uplift_file import Radiance, read_about
from tests.envcal.small_uplift import EYES, SPACE, small_uplift
from uplift.spectrum import illuminant, rgb_space, rgb_weights

ATTRIBUTES = {**provenance.colour_space(SPACE), "envmap": True}
FLOAT32 = 2e-5  # of a spectrum from stored coefficients


@pytest.fixture
def folder(tmp_path):
    """Lamps FL11 and LED-B3, a grey wall under both to equal parts from row 2 on."""
    small_uplift(tmp_path)
    header, planes = exr.read(tmp_path / "clusters.exr", ["R", "G", "B", "cluster", "sky"])
    space = rgb_space(SPACE, observer=EYES)
    both = 0.5 * (illuminant("FL11", EYES) + illuminant("LED-B3", EYES))
    grey = 0.4 * rgb_weights(both, EYES, space).sum(axis=1)
    planes = {name: plane.copy() for name, plane in planes.items()}
    for name, value in zip("RGB", grey, strict=True):
        planes[name][2:] = value
    planes["second"] = (1 - planes["cluster"]).astype(np.uint32)
    planes["weight"] = np.ones(planes["R"].shape, np.float32)
    planes["weight"][2:] = 0.5
    attributes = {**ATTRIBUTES, "envcalLights": header.json("envcalLights")}
    exr.write(tmp_path / "clusters.exr", planes, attributes=attributes)
    exr.write(tmp_path / "map.exr", {name: planes[name] for name in "RGB"}, attributes=ATTRIBUTES)
    return tmp_path


def uplifted(folder, **settings):
    out = folder / "up.exr"
    uplift(read_map(folder / "map.exr"), folder / "clusters.exr", out, UpliftSettings(**settings))
    _, about = read_about(out)
    radiance = Radiance(out, about, EYES.wavelengths_nm)
    return about, radiance(exr.read(out, radiance.channels)[1])


def test_a_grey_wall_under_two_lamps_has_the_spectrum_of_both(folder):
    about, spectra = uplifted(folder)
    assert [cluster.type for cluster in about.clusters][2:5] == ["mixture"] * 3
    assert "50% of the light of cluster 0" in about.clusters[3].source
    true = 0.4 * 0.5 * (illuminant("FL11", EYES) + illuminant("LED-B3", EYES))
    np.testing.assert_allclose(spectra[4, 3], true, rtol=FLOAT32, atol=FLOAT32 * true.max())
    alone = uplifted(folder, mixtures=False)[1]
    assert np.abs(alone[4, 3] - true).max() > 0.1 * true.max()


def test_where_they_are_not_wanted_nothing_is_added(folder):
    about, _ = uplifted(folder, mixtures=False)
    assert "mixture" not in {cluster.type for cluster in about.clusters}


def test_clusters_that_name_one_light_a_pixel_are_taken_as_they_are(folder):
    header, planes = exr.read(folder / "clusters.exr", ["R", "G", "B", "cluster", "sky"])
    attributes = {**ATTRIBUTES, "envcalLights": header.json("envcalLights")}
    exr.write(folder / "clusters.exr", planes, attributes=attributes)
    about, _ = uplifted(folder)
    assert "mixture" not in {cluster.type for cluster in about.clusters}


def test_a_second_light_that_the_file_does_not_hold_is_refused(folder):
    header, planes = exr.read(folder / "clusters.exr", ["R", "G", "B", "cluster", "sky", "second", "weight"])
    planes = {**planes, "second": np.full_like(planes["second"], 7)}
    attributes = {**ATTRIBUTES, "envcalLights": header.json("envcalLights")}
    exr.write(folder / "clusters.exr", planes, attributes=attributes)
    with pytest.raises(EnvcalError, match="names cluster 7, but has 2 lights"):
        uplifted(folder)
