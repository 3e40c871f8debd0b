"""Small test images with a known answer: a chart of measured reflectances before a camera, in a flat picture or a map.

Chart coordinates are those of `calibrate.chart.geometry`; everything else is written out here, slowly and plainly.
"""

import functools

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

WAVELENGTHS_NM = np.arange(400, 701, 10)


@functools.cache
def _colour_data() -> tuple[FloatArray, dict[str, FloatArray], FloatArray, FloatArray]:
    """Reflectances [24, N], lights {name: [N]}, camera sensitivities [N, 3], colour matching functions [N, 3]."""
    import colour

    shape = colour.SpectralShape(400, 700, 10)

    def on_grid(distribution: object) -> FloatArray:
        return np.asarray(distribution.copy().align(shape).values, dtype=np.float64)  # type: ignore[attr-defined]

    chart = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    lights = {name: on_grid(colour.SDS_ILLUMINANTS[name]) for name in ("A", "D65", "D50", "D75", "FL2", "LED-B3")}
    return (
        np.array([on_grid(patch) for patch in chart.values()]),
        lights,
        on_grid(colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]),
        on_grid(colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]),
    )


def light(name: str) -> FloatArray:
    """An illuminant [N], scaled to a mean of 1."""
    spectrum = _colour_data()[1][name]
    return spectrum / spectrum.mean()


def patch_colours(light_name: str = "D65") -> FloatArray:
    """Camera RGB [24, 3] of the chart; a perfect white has G = 1."""
    reflectances, _, camera, _ = _colour_data()
    emission = light(light_name)
    return (reflectances * emission) @ camera / (emission @ camera[:, 1])


def emitter_colour(light_name: str, seen_under: str) -> FloatArray:
    """Camera RGB [3] of a lamp whose Y equals that of a perfect white lit by `seen_under`, in the units of `patch_colours`."""
    _, _, camera, cmfs = _colour_data()
    lamp, scene = light(light_name), light(seen_under)
    return lamp @ camera / (scene @ camera[:, 1]) * (scene @ cmfs[:, 1]) / (lamp @ cmfs[:, 1])


def chart_plane(xy: FloatArray, colours: FloatArray, border: float = 0.8) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Colours [..., 3] at chart coordinates `xy` [..., 2], and where the chart (with a black border) is."""
    x, y = xy[..., 0] - 0.25, xy[..., 1] - 0.25
    column, row = np.floor(x / 2.75), np.floor(y / 2.75)
    on_patch = (x - 2.75 * column < 2.5) & (y - 2.75 * row < 2.5)
    on_patch &= (column >= 0) & (column < 6) & (row >= 0) & (row < 4)
    index = np.where(on_patch, row * 6 + column, 0).astype(int)
    values = np.where(on_patch[..., None], colours[index], 0.7 * colours[23])
    on_chart = (
        (xy[..., 0] > -border) & (xy[..., 0] < 16.75 + border) & (xy[..., 1] > -border) & (xy[..., 1] < 11.25 + border)
    )
    return values, on_chart


def clutter(height: int, width: int, rng: np.random.Generator, pieces: int = 60) -> FloatArray:
    """A wall with rectangles of random muted colours [H, W, 3]."""
    image = np.full((height, width, 3), 0.35) * np.array([0.6, 1.0, 0.7])
    for _ in range(pieces):
        h, w = rng.integers(height // 40 + 2, height // 5), rng.integers(width // 40 + 2, width // 6)
        y, x = rng.integers(0, height - h), rng.integers(0, width - w)
        image[y : y + h, x : x + w] = rng.uniform(0.02, 0.7) * rng.uniform(0.5, 1.0, 3) * np.array([0.6, 1.0, 0.7])
    return image


def homography(source: FloatArray, destination: FloatArray) -> FloatArray:
    """The 3×3 map between two sets of four points [4, 2], by eight linear equations."""
    rows, right = [], []
    for (x, y), (u, v) in zip(source, destination, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right += [u, v]
    return np.append(np.linalg.solve(np.array(rows, float), np.array(right, float)), 1.0).reshape(3, 3)


BOX = np.array([[0, 0], [16.75, 0], [16.75, 11.25], [0, 11.25]])


def flat_picture(
    corners: FloatArray,
    colours: FloatArray,
    *,
    size: tuple[int, int] = (480, 640),
    seed: int = 1,
    noise: float = 0.003,
    supersampling: int = 3,
) -> npt.NDArray[np.float32]:
    """A picture [H, W, 3] of a chart whose box has these corners [4, 2] (px), before a cluttered wall."""
    rng = np.random.default_rng(seed)
    image = clutter(*size, rng)
    inverse = homography(np.asarray(corners, float), BOX)
    offsets = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    total, cover = np.zeros_like(image), np.zeros(size)
    for dy in offsets:
        for dx in offsets:
            y, x = np.mgrid[: size[0], : size[1]]
            lifted = np.stack([x + dx, y + dy, np.ones(size)], -1) @ inverse.T
            values, on_chart = chart_plane(lifted[..., :2] / lifted[..., 2:], colours)
            on_chart &= lifted[..., 2] > 0
            total += values * on_chart[..., None]
            cover += on_chart
    image = total / supersampling**2 + image * (1 - cover / supersampling**2)[..., None]
    return np.asarray(image + noise * rng.standard_normal(image.shape), dtype=np.float32)


def map_directions(height: int, dx: float = 0.0, dy: float = 0.0) -> FloatArray:
    """Unit directions [H, 2H, 3] of a lat-long map's pixels, offset within the pixel; +Y up, −Z at the centre."""
    v, u = np.mgrid[:height, : 2 * height]
    phi = 2 * np.pi * ((u + 0.5 + dx) / (2 * height) - 0.5)
    theta = np.pi * (v + 0.5 + dy) / height
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)


def latlong_picture(
    colours: FloatArray,
    *,
    height: int = 640,
    yaw: float = 20.0,
    pitch: float = -15.0,
    roll: float = 5.0,
    tilt: float = 20.0,
    width_degrees: float = 30.0,
    seed: int = 1,
    noise: float = 0.003,
    supersampling: int = 3,
) -> tuple[npt.NDArray[np.float32], FloatArray]:
    """A lat-long map [H, 2H, 3] with a chart in it, and the chart's corners in the map [4, 2] (px).

    The chart's centre lies in the direction (yaw, pitch) in degrees; it is turned in its plane by `roll`, out of the
    perpendicular by `tilt`, and its box is `width_degrees` wide.
    """
    a, b, r, t = np.radians([yaw, pitch, roll, tilt])
    forward = np.array([np.cos(b) * np.sin(a), np.sin(b), -np.cos(b) * np.cos(a)])
    right = np.array([np.cos(a), 0.0, np.sin(a)])
    down = -np.cross(right, forward)
    right, down = np.cos(r) * right + np.sin(r) * down, np.cos(r) * down - np.sin(r) * right
    right, normal = np.cos(t) * right + np.sin(t) * forward, np.cos(t) * forward - np.sin(t) * right
    scale = 2 * np.tan(np.radians(width_degrees) / 2) / 16.75
    origin = forward - scale * (16.75 / 2 * right + 11.25 / 2 * down)

    rng = np.random.default_rng(seed)
    image = clutter(height, 2 * height, rng)
    total, cover = np.zeros_like(image), np.zeros(image.shape[:2])
    offsets = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    for dy in offsets:
        for dx in offsets:
            d = map_directions(height, dx, dy)
            along = d @ normal
            with np.errstate(divide="ignore", invalid="ignore"):
                point = d * ((origin @ normal) / along)[..., None] - origin
                values, on_chart = chart_plane(np.stack([point @ right, point @ down], -1) / scale, colours)
            on_chart &= along > 1e-6
            total += values * on_chart[..., None]
            cover += on_chart
    image = total / supersampling**2 + image * (1 - cover / supersampling**2)[..., None]
    corners = []
    for x, y in BOX:
        p = origin + scale * (x * right + y * down)
        p = p / np.linalg.norm(p)
        phi, theta = np.arctan2(p[0], -p[2]), np.arccos(p[1])
        corners.append([(phi / (2 * np.pi) + 0.5) * 2 * height - 0.5, theta / np.pi * height - 0.5])
    noisy = image + noise * rng.standard_normal(image.shape)
    return np.asarray(noisy, dtype=np.float32), np.array(corners)
