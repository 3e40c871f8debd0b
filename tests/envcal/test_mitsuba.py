"""The emitter against float64 numpy, against Mitsuba's own emitters, and against itself (sampling and density)."""

import json

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")

from envcal import exr  # noqa: E402
from envcal.errors import EnvcalError  # noqa: E402
from envcal.uplift_file import ATTRIBUTE  # noqa: E402

em = pytest.importorskip("envcal.mitsuba")
from envcal.mitsuba import loading  # noqa: E402

GRID = np.arange(380.0, 781.0, 5.0)
HEIGHT, WIDTH = 16, 32
AXIS = [0.36, 0.48, 0.8]
#: Single precision through a square root, three products and a sum.
AT_A_TEXEL = 1e-5
#: Weights of single precision; neighbours here differ up to a thousandfold.
BETWEEN_TEXELS = 1e-4
#: What Mitsuba multiplies its observer by; a spectrum of Y = 1 has to be divided by it.
WHITE = 106.7502593994140625


def use(variant):
    if variant not in mi.variants():
        pytest.skip(f"this Mitsuba has no {variant}")
    em.set_variant(variant)
    return variant


@pytest.fixture(params=["llvm_ad_spectral", "scalar_spectral"])
def spectral_variant(request):
    return use(request.param)


@pytest.fixture
def llvm():
    use("llvm_ad_spectral")
    import drjit

    return drjit


def some_map(clusters=3, seed=7):
    """Coefficients for nm, scale, cluster and emissions: colours of all kinds, three decades, black, flat 0 and 1."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, HEIGHT, WIDTH)) * np.array([3.0, 2.0, 1.5])[:, None, None]
    a[0, :4] *= 30
    slope, centre = 1 / 200.0, 580.0
    c0, c1 = a * slope**2, b * slope - 2 * a * centre * slope**2
    coefficients = np.stack([c0, c1, c - b * centre * slope + a * (centre * slope) ** 2], axis=-1)
    coefficients[3, 3] = coefficients[5, 9] = 0
    coefficients[3, 3, 2], coefficients[5, 9, 2] = np.inf, -np.inf
    scale = 10 ** rng.uniform(-1.5, 1.5, (HEIGHT, WIDTH))
    scale[6, 6] = 0
    coefficients[6, 6] = 0
    emissions = rng.uniform(0.0, 2.0, (clusters, len(GRID)))
    emissions /= (emissions * photopic()).sum(axis=1, keepdims=True)
    return coefficients.astype(np.float32), scale.astype(np.float32), rng.integers(0, clusters, scale.shape), emissions


def photopic():
    """ȳ·Δλ, near enough for a scale of test spectra (Wyman, Sloan and Shirley 2013, one lobe)."""
    return 5 * 1.056 * np.exp(-0.5 * ((GRID - 560.0) / 47.0) ** 2)


def truth(given, wavelengths):
    """Radiance [height, width, wavelengths] in double precision, as docs/uplift-file.md says it."""
    coefficients, scale, cluster, emissions = given
    c = coefficients.astype(np.float64)[..., None, :]
    with np.errstate(invalid="ignore"):
        x = (c[..., 0] * wavelengths + c[..., 1]) * wavelengths + c[..., 2]
        s = np.where(np.isinf(x), np.sign(x) / 2 + 0.5, 0.5 + x / (2 * np.sqrt(1 + np.where(np.isinf(x), 0, x) ** 2)))
    light = np.stack([np.interp(wavelengths, GRID, e, 0, 0) for e in emissions])
    return scale[..., None].astype(np.float64) * light[cluster] * s * WHITE


def emitter_of(given, **properties):
    coefficients, scale, cluster, emissions = given
    spectral = loading.SpectralMap.from_arrays(coefficients, scale, cluster, wavelengths_nm=GRID, emissions=emissions)
    return em.emitter_from(spectral, **properties)


def direction(u, v):
    phi, theta = 2 * np.pi * u, np.pi * v
    return np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)])


def radiance(emitter, u, v, wavelengths):
    """What `eval` gives for map coordinates [n] and wavelengths [4, n]."""
    d = direction(u, v)
    if mi.variant().startswith("scalar"):
        out = np.empty((4, len(u)))
        for k in range(len(u)):
            si = mi.SurfaceInteraction3f()
            si.wi, si.wavelengths = -mi.Vector3f(*d[:, k]), mi.Spectrum(*wavelengths[:, k])
            out[:, k] = np.array(emitter.eval(si))
        return out
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(u))
    si.wi = -mi.Vector3f(d.astype(np.float32))
    si.wavelengths = mi.Spectrum(wavelengths.astype(np.float32))
    return np.array(emitter.eval(si))


def centres():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return ((x + 0.5) / WIDTH).ravel(), ((y + 0.5) / HEIGHT).ravel()


def in_the_middle(count, seed=0):
    """Wavelengths [4, count] in all of Mitsuba's range; some fall outside of the map's."""
    return np.random.default_rng(seed).uniform(361, 829, (4, count)).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("clusters", [1, 3, 12])
def test_radiance_at_texel_centres_is_that_of_float64(spectral_variant, clusters):
    given = some_map(clusters)
    u, v = centres()
    wavelengths = in_the_middle(len(u))
    expected = np.stack([truth(given, w)[y, x] for w, y, x in texels(wavelengths)], axis=-1)
    found = radiance_at(emitter_of(given), u, v, wavelengths)
    # Where a deep colour is a millionth of the light, the polynomial's own rounding shows.
    assert (np.abs(found - expected) <= AT_A_TEXEL * np.maximum(expected, 1e-6 * expected.max())).all()
    assert found[(wavelengths < 380) | (wavelengths > 780)].max() == 0


def radiance_at(emitter, u, v, wavelengths):
    """What `eval_direction` gives at map coordinates that single precision holds exactly."""
    if mi.variant().startswith("scalar"):
        out = np.empty((4, len(u)))
        for k in range(len(u)):
            it, ds = mi.Interaction3f(), mi.DirectionSample3f()
            it.wavelengths, ds.uv = mi.Spectrum(*wavelengths[:, k]), mi.Point2f(u[k], v[k])
            out[:, k] = np.array(emitter.eval_direction(it, ds))
        return out
    import drjit as dr

    it, ds = dr.zeros(mi.Interaction3f, len(u)), dr.zeros(mi.DirectionSample3f, len(u))
    it.wavelengths = mi.Spectrum(wavelengths.astype(np.float32))
    ds.uv = mi.Point2f(np.stack([u, v]).astype(np.float32))
    return np.array(emitter.eval_direction(it, ds))


def texels(wavelengths):
    y, x = (index.ravel() for index in np.mgrid[:HEIGHT, :WIDTH])
    return ((wavelengths[:, k], y[k], x[k]) for k in range(len(y)))


def test_radiance_between_texels_is_that_of_the_four_weighted(llvm):
    given = some_map()
    rng = np.random.default_rng(3)
    u, v = rng.uniform(0, 1, (2, 4000))
    u[:200], v[200:400], v[400:600] = (
        u[:200] / WIDTH - 0.5 / WIDTH,
        v[200:400] / HEIGHT / 2,
        1 - v[400:600] / HEIGHT / 2,
    )
    u, v = (values.astype(np.float32).astype(np.float64) for values in (u, v))
    wavelengths = in_the_middle(len(u))
    found = radiance_at(emitter_of(given), u, v, wavelengths)
    x, y = u * WIDTH - 0.5, np.clip(v * HEIGHT - 0.5, 0, HEIGHT - 1)
    x0, y0 = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), HEIGHT - 2)
    fx, fy = x - x0, y - y0
    expected = np.zeros_like(found, dtype=np.float64)
    for k in range(len(u)):
        spectra = truth(given, wavelengths[:, k])
        for dy, wy in ((0, 1 - fy[k]), (1, fy[k])):
            for dx, wx in ((0, 1 - fx[k]), (1, fx[k])):
                expected[:, k] += wx * wy * spectra[y0[k] + dy, (x0[k] + dx) % WIDTH]
    inside = (wavelengths > 380) & (wavelengths < 780)
    assert np.abs(found - expected)[inside & (expected > 0)].max() > 0
    shining = inside & (expected > 1e-6 * expected.max())
    assert (np.abs(found - expected) / np.where(shining, expected, 1))[shining].max() <= BETWEEN_TEXELS


def constant_map(emission, value=1.0):
    """Radiance value · emission in every direction."""
    shape = (HEIGHT, WIDTH)
    return (
        np.zeros((*shape, 3), np.float32),
        np.full(shape, 2 * value, np.float32),
        np.zeros(shape, int),
        emission[None],
    )


def flat():
    return np.full(len(GRID), 1 / 106.8)


def test_a_furnace_is_exact_in_every_direction(llvm):
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, 1, (2, 100_000))
    wavelengths = rng.uniform(381, 779, (4, len(u)))
    found = radiance(emitter_of(constant_map(flat(), 3.0)), u, v, wavelengths)
    assert found / (3.0 * WHITE / 106.8) == pytest.approx(1, abs=1e-6)


def scene_around(emitter, *, width=16, objects=True, **integrator):
    look = mi.ScalarTransform4f().look_at([0, 0.5, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": width, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    scene = {
        "type": "scene",
        "light": emitter,
        "integrator": {"type": "path", "max_depth": 6, **integrator},
        "sensor": {"type": "perspective", "fov": 50, "to_world": look, "film": film},
    }
    if objects:
        scene["ball"] = {
            "type": "sphere",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.7}},
        }
    return mi.load_dict(scene)


def rendered(scene, runs, spp):
    """Mean image and its standard error, both averaged over the pixels, [3]."""
    means = np.array([np.array(mi.render(scene, spp=spp, seed=k)).mean((0, 1)) for k in range(runs)])
    return means.mean(0), means.std(0, ddof=1) / np.sqrt(runs)


def test_a_constant_map_lights_a_scene_as_mitsubas_constant_does(llvm):
    emission = np.interp(GRID, [380, 450, 480, 600, 780], [0.2, 1.0, 0.3, 0.9, 0.1]) / 90
    values = ", ".join(map(str, emission * WHITE))
    native = mi.load_dict(
        {
            "type": "constant",
            "radiance": {"type": "regular", "wavelength_min": 380.0, "wavelength_max": 780.0, "values": values},
        }
    )
    ours, error = rendered(scene_around(emitter_of(constant_map(emission))), 8, 64)
    theirs, their_error = rendered(scene_around(native), 8, 64)
    assert (np.abs(ours - theirs) <= 3 * np.hypot(error, their_error)).all()
    assert (np.hypot(error, their_error) < 0.02 * theirs).all(), "too noisy to tell"


def test_white_of_luminance_1_renders_as_1_in_every_channel(llvm):
    from uplift.spectrum import illuminant, observer

    scene = scene_around(emitter_of(constant_map(illuminant("D65", observer()))), objects=False)
    mean, error = rendered(scene, 8, 256)
    # The film's observer and ours are summed over different ranges and steps: 2e-4.
    assert (np.abs(mean - 1) <= 3 * error + 2e-4).all()
    assert error.max() < 0.01


def smooth_picture(width=64):
    """An sRGB lat-long picture without symmetry that a shift of half a row hardly changes."""
    v, u = np.mgrid[: width // 2, :width] / (width / 1.0) + 0.5 / width
    v = 2 * v
    phase = 2 * np.pi * (u[..., None] - np.array([0.1, 0.3, 0.6]))
    return (1.2 + np.sin(phase) * np.sin(np.pi * v[..., None]) - 0.8 * v[..., None] ** 2).astype(np.float32)


@pytest.mark.parametrize("turn", [None, 50.0])
def test_a_picture_stands_as_it_does_in_mitsubas_envmap(turn):
    use("llvm_ad_rgb")
    picture = smooth_picture()
    to_world = mi.ScalarTransform4f().rotate(AXIS, turn) if turn else mi.ScalarTransform4f()
    native = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(picture), "to_world": to_world, "scale": 2.0})
    images = [
        np.array(mi.render(scene_around(emitter, width=48, objects=False), spp=16))
        for emitter in (em.emitter_from(rgb=picture, to_world=to_world, scale=2.0), native)
    ]
    # Rows are centred here and cornered there: half a row of 32 at most, and the picture changes by 4 over its height.
    assert np.abs(images[0] - images[1]).max() < 0.5 / 32 * 4 * 2
    turned = np.abs(images[0][:, ::-1] - images[1]).max()
    assert turned > 5 * np.abs(images[0] - images[1]).max(), "a mirrored picture must be told apart"


def test_the_density_integrates_to_one(llvm):
    dr = llvm
    emitter = emitter_of(some_map())
    finer = 8
    v, u = (index.ravel() for index in np.mgrid[: HEIGHT * finer, : WIDTH * finer] + 0.5)
    u, v = u / (WIDTH * finer), v / (HEIGHT * finer)
    ds = dr.zeros(mi.DirectionSample3f, len(u))
    ds.d = mi.Vector3f(direction(u, v).astype(np.float32))
    density = np.array(emitter.pdf_direction(dr.zeros(mi.Interaction3f), ds), np.float64)
    solid_angle = 2 * np.pi**2 * np.sin(np.pi * v) / len(u)
    assert (density * solid_angle).sum() == pytest.approx(1, abs=1e-4)


def test_samples_follow_the_density(llvm):
    dr = llvm
    emitter = emitter_of(some_map())
    nowhere = dr.zeros(mi.Interaction3f)

    def draw(sample):
        return emitter.sample_direction(nowhere, sample)[0].d

    def density(d):
        ds = dr.zeros(mi.DirectionSample3f, dr.width(d))
        ds.d = d
        return emitter.pdf_direction(nowhere, ds)

    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(), sample_func=draw, pdf_func=density, sample_count=1_000_000, res=64, ires=16
    )
    assert test.run(), test.messages


def drawn(emitter, count, seed=0):
    import drjit as dr

    rng = np.random.default_rng(seed)
    it = dr.zeros(mi.Interaction3f, count)
    it.wavelengths = mi.Spectrum(rng.uniform(385, 775, (4, count)).astype(np.float32))
    it.p = mi.Point3f(1.0, 2.0, 3.0)
    ds, weight = emitter.sample_direction(it, mi.Point2f(rng.uniform(0, 1, (2, count)).astype(np.float32)))
    return it, ds, weight


def test_a_sample_weighs_radiance_over_density(llvm):
    emitter = emitter_of(some_map(), to_world=mi.ScalarTransform4f().rotate(AXIS, 77))
    it, ds, weight = drawn(emitter, 20_000)
    density = np.array(emitter.pdf_direction(it, ds))
    # Near a pole or a border, a direction in single precision is another place of the map by 1e-6 of it.
    assert np.quantile(np.abs(np.array(ds.pdf) / density - 1), 0.999) < 1e-3
    assert np.median(np.abs(np.array(ds.pdf) / density - 1)) < 1e-5
    si = llvm.zeros(mi.SurfaceInteraction3f, 20_000)
    si.wi, si.wavelengths = -ds.d, it.wavelengths
    seen, given = np.array(emitter.eval(si)), np.array(weight) * np.array(ds.pdf)
    assert np.quantile(np.abs(given / seen - 1), 0.999) < 1e-3
    assert np.array(emitter.eval_direction(it, ds)) == pytest.approx(given, rel=1e-5)


def test_the_mean_weight_is_the_integral_of_the_radiance(llvm):
    given = (*some_map()[:3], np.tile(flat(), (3, 1)))
    _, _, weight = drawn(emitter_of(given), 200_000)
    weights = np.array(weight).mean(0)
    finer = 16
    v, u = (index.ravel() for index in np.mgrid[: HEIGHT * finer, : WIDTH * finer] + 0.5)
    u, v = u / (WIDTH * finer), v / (HEIGHT * finer)
    grid = np.linspace(385, 775, 40)
    wavelengths = np.resize(grid, (10, 4))
    seen = np.mean(
        [radiance(emitter_of(given), u, v, np.tile(w[:, None], (1, len(u)))).mean(0) for w in wavelengths], 0
    )
    expected = (seen * 2 * np.pi**2 * np.sin(np.pi * v)).mean()
    error = weights.std() / np.sqrt(len(weights))
    assert abs(weights.mean() - expected) < 4 * error + 0.005 * expected
    assert error < 0.005 * expected, "too noisy to tell"


def test_importance_follows_luminance_so_that_a_sun_costs_no_noise(llvm):
    coefficients, scale, cluster, emission = constant_map(flat())
    scale[4, 11] = 1e5
    _, _, weight = drawn(emitter_of((coefficients, scale, cluster, emission)), 50_000)
    weights = np.array(weight)
    # Drawn uniformly over the sphere the ratio would be some 20; bilinear steps of the sine leave a little.
    assert weights.std() / weights.mean() < 0.1


@pytest.mark.slow
def test_light_traced_from_the_map_meets_what_paths_find(llvm):
    emitter = emitter_of(some_map())
    scene = scene_around(emitter, max_depth=2, hide_emitters=True)
    scene.environment().set_scene(scene)
    tracer = mi.load_dict({"type": "ptracer", "max_depth": 2, "hide_emitters": True})
    paths, path_error = rendered(scene, 6, 256)
    images = [np.array(mi.render(scene, integrator=tracer, spp=512, seed=k)).mean((0, 1)) for k in range(6)]
    light, error = np.mean(images, 0), np.std(images, 0, ddof=1) / np.sqrt(6)
    assert (np.abs(light - paths) <= 4 * np.hypot(error, path_error) + 0.01 * paths).all()
    assert (error < 0.05 * paths).all(), "too noisy to tell"


def test_light_traced_without_knowing_the_scene_is_refused(llvm):
    emitter = emitter_of(some_map())
    with pytest.raises(EnvcalError, match=r"set_scene\(scene\)"):
        emitter.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    emitter = emitter_of(some_map(), center=mi.ScalarPoint3f(1, 0, 0), radius=2.0)
    ray, weight = emitter.sample_ray(0.0, 0.3, mi.Point2f(0.5), mi.Point2f(0.3))
    assert np.linalg.norm(np.array(ray.o).ravel() - [1, 0, 0]) < 2 * np.sqrt(2) + 1e-3
    assert np.array(weight).min() > 0


def pixel_and_gradient(dr, scene, key, value):
    """Mean of a picture as a function of a parameter, and its derivative by automatic differentiation."""
    parameters = mi.traverse(scene)
    parameters[key] = value
    dr.enable_grad(parameters[key])
    parameters.update()
    image = mi.render(scene, parameters, spp=16, seed=0, seed_grad=1)
    loss = dr.mean(image, axis=None)
    dr.backward(loss)
    return float(loss.array[0]), np.array(dr.grad(parameters[key])).ravel()


def with_value(scene, key, value):
    parameters = mi.traverse(scene)
    parameters[key] = value
    parameters.update()
    return float(np.array(mi.render(scene, spp=16, seed=1), np.float64).mean())


def test_gradients_are_those_of_finite_differences(llvm):
    scene = scene_around(emitter_of(some_map()), max_depth=3)
    scene.integrator()
    _, gradient = pixel_and_gradient(llvm, scene, "light.scale", mi.Float(1.5))
    difference = (
        with_value(scene, "light.scale", mi.Float(1.7)) - with_value(scene, "light.scale", mi.Float(1.3))
    ) / 0.4
    assert gradient[0] == pytest.approx(difference, rel=1e-3)


def test_the_gradient_towards_the_emission_is_that_of_finite_differences(llvm):
    # Seen directly, so that no sampling table moves with the emission and the same rays are followed.
    given = some_map()
    scene = scene_around(emitter_of(given), objects=False)
    light = given[3].astype(np.float32)
    _, gradient = pixel_and_gradient(llvm, scene, "light.emission", mi.TensorXf(light))
    gradient = gradient.reshape(light.shape)
    for cluster, node in ((0, 35), (2, 44)):
        step = np.zeros_like(light)
        step[cluster, node] = 0.25 * light.mean()
        up, down = (with_value(scene, "light.emission", mi.TensorXf(light + sign * step)) for sign in (1, -1))
        assert gradient[cluster, node] == pytest.approx((up - down) / (2 * step.max()), rel=1e-2)
        assert abs(gradient[cluster, node]) > 1e-3


def test_the_gradient_towards_a_texel_is_that_of_finite_differences(llvm):
    given = some_map()
    emitter = emitter_of(given)
    u, v = np.array([(7.2 + 0.5) / WIDTH]), np.array([(5.6 + 0.5) / HEIGHT])
    si = llvm.zeros(mi.SurfaceInteraction3f)
    si.wi = -mi.Vector3f(direction(u, v).astype(np.float32))
    si.wavelengths = mi.Spectrum(450.0, 520.0, 580.0, 640.0)
    parameters = mi.traverse(emitter)
    data = np.array(parameters["data"])
    llvm.enable_grad(parameters["data"])
    llvm.backward(llvm.sum(emitter.eval(si)))
    gradient = np.array(llvm.grad(parameters["data"]))[6, 7]

    def value(change):
        moved = data.copy()
        moved[6, 7] += change
        parameters["data"] = mi.TensorXf(moved)
        parameters.update()
        return float(np.array(emitter.eval(si), np.float64).sum())

    for channel in range(4):
        step = np.eye(4, dtype=np.float32)[channel] * 2e-2
        assert gradient[channel] == pytest.approx((value(step) - value(-step)) / 4e-2, rel=2e-2)


def test_changed_data_changes_where_samples_go(llvm):
    emitter = emitter_of(constant_map(flat()))
    parameters = mi.traverse(emitter)
    data = np.array(parameters["data"])
    data[:, : WIDTH // 2, 3] = 0
    parameters["data"] = mi.TensorXf(data)
    parameters.update()
    _, ds, weight = drawn(emitter, 10_000)
    u = np.array(ds.uv.x)
    assert ((u > 0.5 - 1 / WIDTH) | (u < 1 / WIDTH)).all()
    assert np.array(weight).mean() == pytest.approx(2 * np.pi * WHITE / 106.8, rel=0.02)


@pytest.mark.parametrize(
    "variant",
    [
        "scalar_rgb",
        "scalar_spectral",
        pytest.param("scalar_spectral_polarized", marks=pytest.mark.slow),
        "llvm_ad_rgb",
        "llvm_ad_mono",
        pytest.param("llvm_ad_mono_polarized", marks=pytest.mark.slow),
        "llvm_ad_spectral",
        pytest.param("llvm_ad_spectral_polarized", marks=pytest.mark.slow),
    ],
)
def test_every_variant_renders_a_furnace(variant):
    use(variant)
    picture = np.ones((HEIGHT, WIDTH, 3), np.float32)
    emitter = emitter_of(constant_map(flat()), rgb=picture)
    film = {"type": "hdrfilm", "width": 3, "height": 3, "rfilter": {"type": "box"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "light": emitter,
            "integrator": {"type": "path"},
            "sensor": {"type": "perspective", "film": film, "sampler": {"type": "independent"}},
            "pane": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 5]).scale(0.2)},
        }
    )
    image = np.array(mi.render(scene, spp=64))
    assert np.isfinite(image).all()
    if "spectral" in variant:
        assert image[0, 0].mean() == pytest.approx(1.02, abs=0.25)
    else:
        assert image[0, 0] == pytest.approx(1, abs=1e-6)


def write_uplift(path, given, *, rgb=None, **changed):
    coefficients, scale, cluster, emissions = given
    planes = {f"c{k}": np.ascontiguousarray(coefficients[..., k], np.float32) for k in range(3)}
    picture = np.ones((*scale.shape, 3), np.float32) if rgb is None else rgb
    planes |= exr.rgb_planes(picture) | {"scale": scale, "cluster": cluster.astype(np.uint32)}
    planes["status"] = np.zeros(scale.shape, np.uint32)
    light = {"type": "led", "cct": None, "duv": None, "source": "test", "confidence": 1.0}
    about = {
        "format": 1,
        "method": "constrained",
        "space": "ITU-R BT.2020",
        "observer": "CIE 1931 2 Degree Standard Observer",
        "wavelengths_nm": GRID.tolist(),
        "clusters": [light | {"emission": e.tolist()} for e in emissions],
        "status": {"0": "exact"},
    } | changed
    chromaticities = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
    exr.write(path, planes, attributes={ATTRIBUTE: json.dumps(about), "chromaticities": chromaticities, "envmap": True})
    return path


def test_a_file_shines_as_its_arrays_do(spectral_variant, tmp_path):
    given = some_map()
    path = write_uplift(tmp_path / "uplift.exr", given)
    emitter = mi.load_dict({"type": "envcal", "filename": str(path), "scale": 0.5})
    u, v = (values[::7] for values in centres())
    wavelengths = in_the_middle(len(u))
    assert radiance(emitter, u, v, wavelengths) == pytest.approx(
        0.5 * radiance(emitter_of(given), u, v, wavelengths), rel=1e-6
    )
    assert "uplift.exr" in str(emitter)


def test_rgb_variants_show_the_preview_in_srgb(tmp_path):
    use("llvm_ad_rgb")
    import drjit as dr

    rgb = np.full((HEIGHT, WIDTH, 3), np.float32([0.2, 0.5, 0.1]))
    rgb[0, 0] = np.nan
    emitter = mi.load_dict(
        {"type": "envcal", "filename": str(write_uplift(tmp_path / "uplift.exr", some_map(), rgb=rgb))}
    )
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    # Rec. ITU-R BT.2087-0, table 3: the matrix from BT.2020 to BT.709.
    matrix = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    assert np.array(emitter.eval(si)).ravel() == pytest.approx(matrix @ [0.2, 0.5, 0.1], abs=2e-4)
    assert np.isfinite(np.array(mi.traverse(emitter)["data"])).all()


def refused(match, **properties):
    with pytest.raises((EnvcalError, RuntimeError), match=match):
        mi.load_dict({"type": "envcal", **properties})


def test_a_missing_file_name_is_refused(llvm):
    refused("filename")


def test_a_file_with_another_model_is_refused(llvm, tmp_path):
    path = write_uplift(tmp_path / "a.exr", some_map(), model="eight spectra a cell")
    refused("knows `scale", filename=str(path))


def test_a_file_that_is_no_uplift_file_is_refused(llvm, tmp_path):
    exr.write(tmp_path / "a.exr", exr.rgb_planes(np.ones((4, 8, 3), np.float32)), attributes={})
    refused("is not an uplift file", filename=str(tmp_path / "a.exr"))


def test_a_cluster_without_emission_is_refused(llvm, tmp_path):
    given = some_map()
    given[2][2, 5] = 3
    refused("of cluster 3", filename=str(write_uplift(tmp_path / "a.exr", given)))


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_a_scale_that_is_no_radiance_is_refused_with_its_place(llvm, tmp_path, bad):
    given = some_map()
    given[1][2, 5] = bad
    refused("x=5, y=2", filename=str(write_uplift(tmp_path / "a.exr", given)))


def test_a_transform_that_stretches_is_refused(llvm):
    with pytest.raises(EnvcalError, match="stretch"):
        emitter_of(some_map(), to_world=mi.ScalarTransform4f().scale([1, 2, 1]))


@pytest.mark.parametrize("bad", ["a", -1.0, float("nan"), float("inf"), [1.0, 2.0, 3.0]])
def test_a_scale_that_is_no_number_is_refused_by_its_name(spectral_variant, bad):
    with pytest.raises(
        (EnvcalError, RuntimeError), match=r"scale of an `envcal` emitter is .*; expected a number from 0"
    ):
        emitter_of(some_map(), scale=bad)


#: As docs/mitsuba.md has them: up, middle of the map, to_world.
TURNS = [
    ((0, 1, 0), (0, 0, 1), lambda t: t),
    ((0, 1, 0), (0, 0, -1), lambda t: t.rotate([0, 1, 0], 180)),
    ((0, 0, 1), (0, -1, 0), lambda t: t.rotate([1, 0, 0], 90)),
    ((0, 0, 1), (0, 1, 0), lambda t: t.rotate([0, 0, 1], 180).rotate([1, 0, 0], 90)),
]


@pytest.mark.parametrize(("up", "middle", "turn"), TURNS)
def test_the_transforms_of_the_docs_put_the_middle_where_they_say(up, middle, turn):
    """Red in the middle, green above, blue at the right hand of who looks at the middle."""
    use("scalar_rgb")
    picture = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    picture[HEIGHT // 2 - 2 : HEIGHT // 2 + 2, WIDTH // 2 - 2 : WIDTH // 2 + 2, 0] = 1
    picture[:2, :, 1] = 1
    picture[HEIGHT // 2 - 2 : HEIGHT // 2 + 2, 3 * WIDTH // 4 - 2 : 3 * WIDTH // 4 + 2, 2] = 1
    emitter = em.emitter_from(rgb=picture, to_world=turn(mi.ScalarTransform4f()))

    def seen(d):
        si = mi.SurfaceInteraction3f()
        si.wi = -mi.Vector3f(*(float(v) for v in d))
        return np.array(emitter.eval(si)).round(3).tolist()

    assert seen(middle) == [1, 0, 0] and seen(up) == [0, 1, 0] and seen(np.cross(middle, up)) == [0, 0, 1]


def test_a_transform_that_scales_evenly_only_turns(llvm):
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 30)
    plain, scaled = (emitter_of(some_map(), to_world=t) for t in (turn, turn @ mi.ScalarTransform4f().scale(7.0)))
    u, v = centres()
    wavelengths = in_the_middle(len(u))
    assert radiance(scaled, u, v, wavelengths) == pytest.approx(radiance(plain, u, v, wavelengths), rel=1e-4)


def test_arrays_that_do_not_fit_are_refused():
    coefficients, scale, cluster, emissions = some_map()
    for change, match in (
        ({"scale": scale[1:]}, "expected"),
        ({"wavelengths_nm": GRID[::-1]}, "ascending"),
        ({"wavelengths_nm": GRID[:-1]}, "one value per wavelength"),
        ({"emissions": -emissions}, "negative"),
    ):
        given = {"scale": scale, "cluster": cluster, "wavelengths_nm": GRID, "emissions": emissions} | change
        with pytest.raises(EnvcalError, match=match):
            loading.SpectralMap.from_arrays(coefficients, **given)


def test_a_spectral_variant_needs_spectra_and_an_rgb_variant_rgb(llvm):
    with pytest.raises(EnvcalError, match="spectral variants need"):
        em.emitter_from(rgb=smooth_picture())
    use("llvm_ad_rgb")
    with pytest.raises(EnvcalError, match="linear sRGB"):
        emitter_of(some_map())


def test_positions_are_refused_where_mitsubas_envmap_refuses(llvm):
    _, density = emitter_of(some_map()).sample_position(0.0, mi.Point2f(0.5))
    assert np.isnan(np.array(density)).all()
    use("scalar_spectral")
    with pytest.raises(EnvcalError, match="no positions"):
        emitter_of(some_map()).sample_position(0.0, mi.Point2f(0.5))
