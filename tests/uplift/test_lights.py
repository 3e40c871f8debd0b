"""From clusters to lights: types, temperatures, declarations, and what is refused."""

import numpy as np
import pytest

from tests.uplift.relit import OBSERVER, SPACE, emission_rgb, open_air, room
from uplift import UpliftError
from uplift.cluster import cluster_angles
from uplift.illuminants import cct_duv_of, family_emission
from uplift.lights import HALOPHOSPHATE, Declared, lights_of
from uplift.sky import find_sky
from uplift.spectrum import illuminant

LAMP_CCT = 0.005  # of a lamp in view; see test_cluster
A_AT, D65_AT = (0.63, 0.26), (0.13, 0.26)  # where `room(["D65", "A"])` shows its lamps


def found(image, **settings):
    sky = find_sky(image, SPACE.luminance_weights)
    clusters = cluster_angles(
        image, luminance_weights=SPACE.luminance_weights, xyz_from_rgb=SPACE.xyz_from_rgb, sky=sky
    )
    return lights_of(image, clusters, observer=OBSERVER, space=SPACE, **settings)


def warm(lights):
    return min(lights, key=lambda light: light.cct_seen)


def cool(lights):
    return max(lights, key=lambda light: light.cct_seen)


def test_an_undeclared_indoor_light_is_unknown_smooth_and_says_what_would_help():
    lights = found(room(["D65", "A"]))
    assert lights.warnings == ()
    assert [light.cluster for light in lights] == [0, 1]
    assert len(lights) == 2
    assert lights[1] is lights.lights[1]
    for light in lights:
        assert light.type == "smooth"
        assert not light.declared
        assert light.confidence < 0.5
        assert "type" in light.remedy
        np.testing.assert_allclose(light.emission, family_emission("smooth", light.cct, OBSERVER), rtol=1e-6)
    assert warm(lights).cct_seen == pytest.approx(2855.5, rel=LAMP_CCT)
    assert warm(lights).cct == pytest.approx(2 / (1 / 2855.5 + 1 / 6503.0), rel=LAMP_CCT)  # half-way to D65 in mired
    assert cool(lights).cct == pytest.approx(6503.0, rel=LAMP_CCT)


@pytest.mark.parametrize("indoor", ["led", "incandescent", "fluorescent"])
def test_a_setting_for_indoor_lights_gives_their_family_at_the_cct_seen(indoor):
    light = found(room(["LED-B2"]), indoor=indoor)[0]
    assert light.type == indoor
    assert light.cct == pytest.approx(2999.0, rel=LAMP_CCT)
    assert light.confidence > 0.5


def test_a_furnace_of_d65_is_lit_by_exactly_d65():
    image = np.full((32, 64, 3), 0.7, np.float32)
    np.testing.assert_array_equal(found(image)[0].emission, illuminant("D65", OBSERVER))


def test_outdoors_is_daylight_from_5000_kelvin_and_a_low_sun_below():
    day = found(open_air(height=128))[0]
    assert day.type == "daylight"
    assert day.outdoor
    low = found(open_air(height=128, sky="FL8", sun_lamp="HP2"), indoor="led")[0]
    assert low.type == "sunset"
    assert low.outdoor


def test_the_papers_estimator_is_mccamy_of_the_mean():
    from uplift.cct import mccamy, xy_of_rgb

    image = room(["A"])
    light = found(image, estimator="paper")[0]
    theta = np.pi * (np.arange(64) + 0.5) / 64
    mean = (image * np.sin(theta)[:, np.newaxis, np.newaxis]).sum(axis=(0, 1))
    assert light.cct_seen == pytest.approx(float(mccamy(xy_of_rgb(mean, SPACE.xyz_from_rgb))), rel=1e-3)


def test_the_papers_outdoor_estimate_is_the_mean_of_two():
    from uplift.cct import mccamy, xy_of_rgb

    image = open_air(height=128)
    light = found(image, estimator="paper")[0]
    theta = np.pi * (np.arange(128) + 0.5) / 128
    colours = [(image * np.sin(theta)[:, np.newaxis, np.newaxis]).sum(axis=(0, 1)), emission_rgb("D50")]
    both = [float(mccamy(xy_of_rgb(colour, SPACE.xyz_from_rgb))) for colour in colours]
    assert light.cct_seen == pytest.approx(np.mean(both), rel=1e-3)


def test_a_measured_cct_beyond_a_family_is_clamped_with_a_warning():
    lights = found(room(["HP1"]), indoor="fluorescent")
    assert lights[0].cct == pytest.approx(2940.0, abs=0.1)
    assert lights[0].cct_seen == pytest.approx(1962.0, rel=LAMP_CCT)
    assert len(lights.warnings) == 2
    assert "beyond fluorescent (2940 to 6425 K)" in lights.warnings[0]


@pytest.mark.parametrize("declared", [True, False])
def test_a_fluorescent_light_of_no_name_is_warned_of_with_the_remedy(declared):
    said = [Declared(at=A_AT, type="fluorescent", cct=4000.0)] if declared else []
    lights = found(room(["D65", "FL11"]), indoor="auto" if declared else "fluorescent", declared=said)
    assert lights.warnings[-1].startswith("light" if declared else "lights 0, 1")
    assert "Name the tube: type FL12, FL11 or FL10" in lights.warnings[-1]
    assert "FL11" in warm(lights).remedy


def test_a_fluorescent_light_of_no_name_has_the_asked_cct_and_is_mostly_halophosphate():
    light = warm(found(room(["D65", "FL3"]), declared=[Declared(at=A_AT, type="fluorescent", cct=3446.0)]))
    assert light.cct == pytest.approx(3446.0, abs=0.01)
    halophosphate, smooth = (family_emission(name, 3446.0, OBSERVER) for name in ("fluorescent", "smooth"))
    expected = HALOPHOSPHATE * halophosphate + (1.0 - HALOPHOSPHATE) * smooth
    np.testing.assert_allclose(light.emission, expected, rtol=1e-9)


def test_a_named_tube_is_the_published_one_without_a_warning():
    lights = found(room(["D65", "FL11"]), declared=[Declared(at=A_AT, type="FL11")])
    assert lights.warnings == ()
    assert warm(lights).remedy == ""
    np.testing.assert_array_equal(warm(lights).emission, illuminant("FL11", OBSERVER))


@pytest.mark.parametrize(("name", "warned"), [("LED-RGB1", True), ("LED-B2", False)])
def test_a_light_said_to_be_an_led_of_another_colour_than_white_leds_is_warned_of(name, warned):
    lights = found(room(["D65", name]), declared=[Declared(at=A_AT, type="led")])
    assert any("side of white phosphor LEDs" in text for text in lights.warnings) == warned


def test_a_camera_that_errs_a_little_is_no_reason_to_doubt_that_an_led_is_one():
    declared = [Declared(at=A_AT, type="led")]

    def doubted(green, **settings):
        off = room(["D65", "LED-B2"]) * np.array([green, 1.0, green], np.float32)
        return any("side of white phosphor LEDs" in text for text in found(off, declared=declared, **settings).warnings)

    # 0.005 and 0.007 of Duv to the green side; 2.6 % of CCT are 9 mired here, and 0.004 of a length in (u, v).
    assert doubted(0.93) and not doubted(0.93, calibration=0.026)
    assert doubted(0.90, calibration=0.026)


def test_a_coloured_light_gets_a_warning_and_still_a_spectrum():
    lights = found(np.full((16, 32, 3), [0.0, 1.0, 0.0], np.float32))
    assert "Give its measured spectrum" in lights.warnings[0]
    assert np.isfinite(lights[0].emission).all()
    assert np.isfinite(lights[0].cct)


def test_a_black_map_is_lit_by_d65_without_any_confidence():
    lights = found(np.zeros((8, 16, 3), np.float32))
    assert lights[0].confidence == 0.0
    assert lights[0].cct == pytest.approx(6503.0, abs=0.1)
    assert "no light" in lights.warnings[0]


# ---- declared ----


def test_a_declared_type_and_cct_apply_to_the_cluster_at_the_place_only():
    lights = found(room(["D65", "A"]), declared=[Declared(at=A_AT, type="incandescent", cct=2700.0)])
    assert warm(lights).type == "incandescent"
    assert warm(lights).cct == pytest.approx(2700.0, abs=0.01)
    assert warm(lights).cct_seen == pytest.approx(2855.5, rel=LAMP_CCT)
    assert warm(lights).declared
    assert warm(lights).remedy == ""
    assert not cool(lights).declared


def test_a_declared_type_alone_takes_the_cct_seen():
    light = warm(found(room(["D65", "A"]), declared=[Declared(at=A_AT, type="led")]))
    assert light.type == "led"
    assert light.cct == pytest.approx(2855.5, rel=LAMP_CCT)


def test_a_declared_cct_alone_is_used_with_an_unknown_type():
    light = warm(found(room(["D65", "A"]), declared=[Declared(at=A_AT, cct=2600.0)]))
    assert (light.type, light.declared) == ("smooth", True)
    assert light.cct == pytest.approx(2600.0, abs=0.01)
    assert light.remedy != ""


@pytest.mark.parametrize(("name", "kind"), [("FL11", "fluorescent"), ("LED-V2", "led"), ("HP1", "discharge")])
def test_a_lamp_is_declared_by_its_cie_name(name, kind):
    light = cool(found(room(["D65", "A"]), declared=[Declared(at=D65_AT, type=name)]))
    assert light.type == kind
    np.testing.assert_array_equal(light.emission, illuminant(name, OBSERVER))


def test_a_declared_spectrum_is_the_lights_own():
    emission = 5.0 * illuminant("FL3.15", OBSERVER)
    light = cool(found(room(["D65", "A"]), declared=[Declared(at=D65_AT, emission=emission, name="tube")]))
    assert (light.type, light.name, light.confidence) == ("measured", "tube", 1.0)
    np.testing.assert_allclose(light.emission, illuminant("FL3.15", OBSERVER), rtol=1e-12)
    assert light.cct == pytest.approx(cct_duv_of(emission, OBSERVER)[0])


def test_a_place_at_the_edge_of_the_map_is_on_it():
    for at in ((0.0, 0.0), (1.0, 1.0)):
        assert sum(light.declared for light in found(room(["D65", "A"]), declared=[Declared(at=at, type="led")])) == 1


def test_two_declarations_of_one_cluster_are_told():
    lights = found(room(["A"]), declared=[Declared(at=A_AT, type="led"), Declared(at=(0.2, 0.6), type="FL11")])
    assert lights[0].type == "led"
    assert "declared light 2 is not used: it is in the same cluster (0) as declared light 1" in lights.warnings[0]


def test_two_lamps_too_alike_to_be_told_apart_are_told_so():
    image = room(["A"])
    image[16:18, 16:18] = 400.0 * emission_rgb("A")  # the same lamp twice
    image[16:18, 100:102] = 400.0 * emission_rgb("A")
    at = ((17 / 128, 17 / 64), (101 / 128, 17 / 64))
    warning = found(image, declared=[Declared(at=at[0], type="led"), Declared(at=at[1], type="FL11")]).warnings[0]
    assert "0 mired and Duv 0.000 apart, too alike to be told apart (20 mired or Duv 0.008 are enough)" in warning
    assert "too dim" not in warning


def test_a_window_too_dim_to_count_as_a_lamp_is_not_called_too_alike():
    image = room(["D65"])
    image[14:22, 14:22] = 4000.0 * emission_rgb("D65")
    image[30:34, 90:94] = 12.0 * emission_rgb("A")  # far brighter than a wall, far less than the lamp
    lamp, window = (17 / 128, 17 / 64), (92 / 128, 32 / 64)
    lights = found(
        image, declared=[Declared(at=lamp, type="led", name="softbox"), Declared(at=window, type="FL4", name="window")]
    )
    (warning,) = [text for text in lights.warnings if "not used" in text]
    assert len(lights) == 1
    assert "declared light 2 (window) is not used" in warning
    assert "declared light 1 (softbox)" in warning
    assert "196 mired" in warning  # 1e6/2855.5 − 1e6/6503
    assert "not too alike" in warning
    assert (
        "too dim beside the other to count as a lamp: its luminance is 12, and a lamp of this map begins at" in warning
    )
    assert "declare the stronger light alone" in warning


def test_a_lamp_bright_enough_that_sheds_too_little_is_told_so():
    image = room(["D65"])
    image[8:32, 10:60] = 400.0 * emission_rgb("D65")
    image[40, 100] = 300.0 * emission_rgb("A")  # under a hundredth of the light
    declared = [
        Declared(at=(35 / 128, 20 / 64), type="led"),
        Declared(at=(100.5 / 128, 40.5 / 64), type="incandescent"),
    ]
    (warning,) = [text for text in found(image, declared=declared).warnings if "not used" in text]
    assert "sheds too little of the light" in warning
    assert "too dim" not in warning


def test_two_declarations_under_the_sky_are_one_outdoor_light():
    image = open_air(height=128)
    declared = [Declared(at=(0.7, 0.1), type="daylight"), Declared(at=(0.34, 0.255), type="sunset")]
    (warning,) = [text for text in found(image, declared=declared).warnings if "not used" in text]
    assert "one outdoor light" in warning


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        (Declared(at=(1.2, 0.5), type="led"), "expected u and v from 0 to 1"),
        (Declared(at=(float("nan"), 0.5), type="led"), "expected u and v from 0 to 1"),
        (Declared(at=A_AT), "says nothing"),
        (Declared(at=A_AT, type="neon"), "'neon' is unknown"),
        (Declared(at=A_AT, type="measured"), "without a spectrum"),
        (Declared(at=A_AT, type="FL11", cct=4000.0), "a cct of its own"),
        (Declared(at=A_AT, type="incandescent", cct=6500.0), "expected 1000 to 4000 K for incandescent"),
        (Declared(at=A_AT, cct=900.0), "for a light of unknown type"),
        (Declared(at=A_AT, type="led", emission=np.ones(81)), "a spectrum says it all"),
        (Declared(at=A_AT, emission=np.ones(80)), "resample it first"),
        (Declared(at=A_AT, emission=-np.ones(81)), "negative or not finite"),
    ],
)
def test_a_wrong_declaration_is_refused(declared, message):
    with pytest.raises(UpliftError, match=message):
        found(room(["D65", "A"]), declared=[declared])


def test_all_mistakes_come_at_once_with_the_names_of_their_lights():
    with pytest.raises(UpliftError) as error:
        found(room(["A"]), indoor="leds", declared=[Declared(at=A_AT, name="desk"), Declared(at=A_AT, type="neon")])
    assert "indoor: 'leds'" in str(error.value)
    assert "declared light 1 (desk)" in str(error.value)
    assert "declared light 2" in str(error.value)


def test_a_place_in_the_dark_is_refused():
    image = room(["A"])
    image[:, :16] = 0.0
    with pytest.raises(UpliftError, match="black or empty"):
        found(image, declared=[Declared(at=(0.05, 0.5), type="led")])


def test_an_unknown_estimator_and_another_maps_clusters_are_refused():
    image = room(["A"])
    with pytest.raises(UpliftError, match="estimator"):
        found(image, estimator="mccamy")
    clusters = cluster_angles(image, luminance_weights=SPACE.luminance_weights, xyz_from_rgb=SPACE.xyz_from_rgb)
    with pytest.raises(UpliftError, match="expected those of the same map"):
        lights_of(image[:-1], clusters, observer=OBSERVER, space=SPACE)


# ---- how sure ----


def test_probabilities_of_the_kinds_sum_to_one_and_a_declared_kind_is_certain():
    lights = found(room(["D65", "A"]), declared=[Declared(at=A_AT, type="led")])
    for light in lights:
        assert sum(light.kinds.values()) == pytest.approx(1.0)
    assert warm(lights).kinds["led"] == 1.0
    assert cool(lights).kinds["incandescent"] < 0.05


def test_under_a_sky_the_light_is_daylight_almost_surely():
    assert found(open_air(height=128))[0].kinds["daylight"] > 0.95


def test_an_error_of_the_calibration_widens_the_temperatures():
    image = room(["A"])
    sure, unsure = found(image)[0], found(image, calibration=0.04)[0]
    assert unsure.cct_sigma**2 == pytest.approx(sure.cct_sigma**2 + (0.04 * sure.cct_seen) ** 2)
    assert 0 < sure.duv_sigma < 0.01


def test_a_spectrum_of_the_library_with_the_lights_colour_is_suggested_and_not_used():
    library = [("tube.csv", illuminant("FL3.15", OBSERVER)), ("bulb.csv", illuminant("A", OBSERVER))]
    lights = found(room(["D65", "A"]), library=library)
    assert "bulb.csv" in warm(lights).remedy and "spd: bulb.csv" in warm(lights).remedy
    assert warm(lights).type == "smooth"
    assert "bulb" not in cool(lights).remedy
    assert "library" not in found(room(["LED-B3"]), library=library)[0].remedy
