"""Light in the synthetic room against formulas of radiometry; geometry against its own inverse."""

from dataclasses import replace

import numpy as np
import pytest

from samples import Camera, Chart, Furnace, LatLong, Module, Pinhole, Room, chart_view, look, spectra, transport
from samples.places import STANDING, Lamp
from samples.scene import build
from samples.view import _nodes, indirect_light

LUMINANCE = spectra.cmfs().T * (spectra.LUMENS_PER_WATT * spectra.STEP_NM)
# Transport is stored in float32.
SINGLE = 1e-6
# 14 × 14 nodes a wall and 160 directions a node integrate a lamp 70 cm from a wall to about this.
NODES = 0.04


def _direct(lamp: Lamp, place: tuple[float, float, float], normal: tuple[float, float, float]) -> float:
    """Return the irradiance per radiance at a place of an empty room with one lamp."""
    scene = build(Room(lamps=(lamp,), chart=None, module=None, furniture=False))
    light = np.empty((1, 1, 1), np.float32)
    shape = (1, 1, 3)
    transport.shine(
        0, 1, scene.geometry, np.zeros((1, 1), np.int16), np.reshape(place, shape).astype(float),
        np.reshape(normal, shape).astype(float), np.full((1, 2), 0.5), 24, light,
    )  # fmt: skip
    return float(light[0, 0, 0])


@pytest.mark.parametrize("projection", [LatLong(64), Pinhole(64, 48, 70.0, 30.0, -20.0)])
def test_pixels_undo_directions(projection: LatLong | Pinhole) -> None:
    found = projection.pixels(projection.directions(1)[:, 0])
    y, x = np.divmod(np.arange(projection.width * projection.height), projection.width)
    np.testing.assert_allclose(found, np.stack([x, y], axis=-1), atol=1e-9)


def test_the_middle_of_a_map_looks_along_minus_z_and_its_right_half_towards_plus_x() -> None:
    projection = LatLong(64)
    np.testing.assert_allclose(projection.pixels(np.array([0.0, 0.0, -1.0])), [31.5, 15.5])
    np.testing.assert_allclose(projection.pixels(np.array([1.0, 0.0, 0.0])), [47.5, 15.5])
    np.testing.assert_allclose(projection.pixels(np.array([0.0, 1.0, 0.0]))[1], -0.5)


def test_a_globe_lights_as_the_formula_of_a_sphere_says() -> None:
    globe = Lamp("globe", "A", "globe", (0.0, 1.6, 0.0), (0.2,), 1.0)
    place = np.array([1.1, 0.4, -0.7])
    away = np.array(globe.centre) - place
    distance = np.linalg.norm(away)
    expected = np.pi * (0.2 / distance) ** 2 * away[0] / distance * -1.0
    # E = π L (r / d)² cos θ (Lambert 1760), exact for a sphere wholly above the horizon.
    normal = (-1.0, 0.0, 0.0)
    assert _direct(globe, tuple(place), normal) == pytest.approx(expected, rel=2e-3)


def test_a_panel_lights_as_the_formula_of_a_rectangle_says() -> None:
    panel = Lamp("panel", "A", "panel", (0.0, 2.5, 0.0), (1.0, 0.6), 1.0)
    # Under a corner, parallel: E = L/2 · (A atan B + C atan D), a² and b² over sides and height (Howell, C-11).
    height = 2.5 - 0.012 - 1.0
    a, b = 1.0 / height, 0.6 / height
    p, q = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
    expected = 0.5 * (a / p * np.arctan(b / p) + b / q * np.arctan(a / q))
    assert _direct(panel, (0.5, 1.0, 0.3), (0.0, 1.0, 0.0)) == pytest.approx(expected, rel=1e-3)


def test_nothing_shines_through_the_chart() -> None:
    scene = build(Room(furniture=False))
    assert scene.chart_corners is not None
    middle = scene.chart_corners.mean(axis=0)
    panel = scene.geometry.boxes[scene.geometry.lamps[0, 1]][:3]
    behind = middle - 0.3 * (panel - middle) / np.linalg.norm(panel - middle)
    light = np.empty((1, 2, 2), np.float32)
    places = np.stack([behind, behind + np.array([0.0, 0.0, -0.8])])[None]
    normals = np.broadcast_to((panel - middle) / np.linalg.norm(panel - middle), (1, 2, 3)).copy()
    transport.shine(0, 1, scene.geometry, np.zeros((1, 2), np.int16), places, normals, np.full((2, 2), 0.5), 6, light)
    assert light[0, 0, 0] < 0.7 * light[0, 1, 0]


def test_a_closed_grey_room_absorbs_the_flux_of_its_lamp() -> None:
    albedo = 0.5
    lamp = replace(STANDING, centre=(-1.93, 1.43, -1.42))
    place = Room(lamps=(lamp,), chart=None, module=None, furniture=False, grey=albedo, bounces=30)
    scene = build(place)
    places, _ = _nodes(scene.geometry)
    grid, half = int(scene.geometry.grids[0]), scene.geometry.boxes[0][12:15]
    areas = np.repeat([4.0 * half[(f // 2 + 1) % 3] * half[(f // 2 + 2) % 3] / grid**2 for f in range(6)], grid**2)
    indirect = indirect_light(scene)[: 6 * grid**2, 0, 40]
    assert len(places) > len(areas)
    # In equilibrium the indirect flux is ρ / (1 − ρ) of the lamp's, π · 4 π r² for radiance one.
    radius = STANDING.size[0]
    flux = np.pi * 4.0 * np.pi * radius**2
    assert (indirect * areas).sum() * (1.0 - albedo) / albedo == pytest.approx(flux, rel=NODES)


def test_a_furnace_returns_its_constant_radiance() -> None:
    seen = look(Furnace("LED-B4", 80.0), LatLong(32)).radiance()
    expected = np.broadcast_to(80.0 * spectra.lamp("LED-B4"), seen.shape)
    np.testing.assert_allclose(seen, expected, rtol=SINGLE)


def test_a_patch_in_a_furnace_reads_its_reflectance() -> None:
    view = look(Furnace("D65", 80.0, Chart(), Module(spectrum="D65")), LatLong(512))
    cube = view.radiance()
    assert view.scene.patch_corners is not None
    x, y = np.round(view.pixels(view.scene.patch_corners).mean(axis=1)).astype(int).T
    expected = 80.0 * spectra.lamp("D65") * spectra.chart_reflectances()
    np.testing.assert_allclose(cube[y, x], expected, rtol=SINGLE, atol=1e-12)


def test_the_response_to_a_mixture_of_lamps_is_the_mixture_of_responses() -> None:
    view = look(Room(), LatLong(64))
    parts = [np.zeros_like(view.scene.emission) for _ in view.scene.emission]
    for index, part in enumerate(parts):
        part[index] = view.scene.emission[index]
    total = sum(view.response(LUMINANCE, spectra=part) for part in parts)
    np.testing.assert_allclose(total, view.response(LUMINANCE), rtol=1e-9, atol=1e-12)


def test_the_integral_of_the_cube_is_the_response() -> None:
    view = look(Room(), LatLong(64))
    camera = Camera().responses
    np.testing.assert_allclose(view.radiance() @ camera.T, view.response(camera), rtol=1e-4, atol=1e-9)


def test_exchanged_lamps_equal_a_room_with_those_lamps() -> None:
    view = look(Room(), LatLong(64))
    others = tuple(replace(lamp, spectrum="FL11", luminance=700.0) for lamp in Room().lamps)
    emission = view.scene.emission.copy()
    emission[:2] = 700.0 * spectra.lamp("FL11")
    other = look(Room(lamps=others), LatLong(64))
    np.testing.assert_allclose(view.response(LUMINANCE, spectra=emission), other.response(LUMINANCE), rtol=1e-12)


def test_the_number_of_threads_does_not_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for workers in (1, 3):
        monkeypatch.setattr(transport, "WORKERS", workers)
        indirect_light.cache_clear()
        found.append(look.__wrapped__(Room(seed=5), LatLong(64)).response(LUMINANCE))
    np.testing.assert_array_equal(found[0], found[1])


def test_a_seed_changes_the_room() -> None:
    views = [look(Room(seed=seed), LatLong(64)).response(LUMINANCE) for seed in (0, 1)]
    assert np.mean(np.abs(views[0] - views[1]) > 0.05 * views[0]) > 0.3


def test_the_chart_stands_where_its_corners_say() -> None:
    found = chart_view(320, 240, yaw_deg=12.0, pitch_deg=8.0, roll_deg=5.0)
    white, black = (found.patch_quads[i].mean(axis=0).round().astype(int) for i in (18, 23))
    assert found.rgb[white[1], white[0], 1] > 15.0 * found.rgb[black[1], black[0], 1]
    # A patch quad shrunk by a pixel holds one value; grown by two it does not.
    for quad in found.patch_quads:
        low, high = np.ceil(quad.min(axis=0) + 9), np.floor(quad.max(axis=0) - 9)
        inside = found.rgb[int(low[1]) : int(high[1]), int(low[0]) : int(high[0])]
        assert inside.size and np.ptp(inside.reshape(-1, 3), axis=0).max() < 1e-6


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (10.0, 8.0, 6.0)])
def test_opencv_finds_the_chart_where_it_stands(turn: tuple[float, float, float]) -> None:
    import cv2

    found = chart_view(640, 480, yaw_deg=turn[0], pitch_deg=turn[1], roll_deg=turn[2])
    bright = np.clip(2.0 * found.rgb / found.rgb[..., 1].max(), 0.0, 1.0) ** (1 / 2.2)
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    detector.setUseDnnModel(False)
    assert detector.process(np.ascontiguousarray((255 * bright[..., ::-1]).astype(np.uint8)), 1)
    box = np.array(detector.getBestColorChecker().getBox())
    # mcc's corners are 5 to 10 pixels off on charts of this size.
    assert np.abs(box - found.chart_corners).max() < 10.0
