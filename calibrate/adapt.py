"""Von Kries adaptation in a named cone space: one diagonal gain that turns a source white into a destination white.

J. von Kries (1902); the cone spaces are those of

- CAT16: C. Li et al., "Comprehensive color solutions: CAM16, CAT16, and CAM16-UCS" (2017)
- Bradford: K. M. Lam (1985), as in ICC.1:2022, Annex E
- CAT02: CIE 159:2004, CIECAM02
- Von Kries: Hunt–Pointer–Estévez primaries normalised to D65 (M. D. Fairchild, *Color Appearance Models*)
- XYZ Scaling: the XYZ values themselves
- RGB: the channels of the working space, as a plain white balance does

Which one is taken matters under warm light: recovering the CCT of a 2000 K light from an ideal D65 lamp is off by 1.6 %
in CAT16, 12 % in Bradford and 90 % in XYZ scaling (mean of 52 cameras), so CAT16 is the default. No degree of
adaptation and no non-linear compression: the map stays linear in radiance.
"""

from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError

CONE_FROM_XYZ: Final[dict[str, npt.NDArray[np.float64]]] = {
    "CAT16": np.array(
        [[0.401288, 0.650173, -0.051461], [-0.250268, 1.204414, 0.045854], [-0.002079, 0.048952, 0.953127]]
    ),
    "Bradford": np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]),
    "CAT02": np.array([[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]]),
    "Von Kries": np.array([[0.40024, 0.70760, -0.08081], [-0.22630, 1.16532, 0.04570], [0.0, 0.0, 0.91822]]),
    "XYZ Scaling": np.eye(3),
}
for _matrix in CONE_FROM_XYZ.values():
    _matrix.setflags(write=False)

TRANSFORMS: Final[tuple[str, ...]] = (*CONE_FROM_XYZ, "RGB")


def cone_matrix(transform: str, xyz_from_rgb: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return cone_from_rgb [3, 3] of a named transform for a working space given by `xyz_from_rgb` [3, 3]."""
    if transform == "RGB":
        return np.eye(3)
    if transform not in CONE_FROM_XYZ:
        raise CalibrateError(
            f"balance.transform: {transform!r} is no known cone space; expected one of {', '.join(TRANSFORMS)}. "
            "Set `balance.transform: CAT16`."
        )
    return np.asarray(CONE_FROM_XYZ[transform] @ np.asarray(xyz_from_rgb, dtype=np.float64))


def von_kries_matrix(
    source_rgb: npt.NDArray[np.float64],
    destination_rgb: npt.NDArray[np.float64],
    *,
    xyz_from_rgb: npt.NDArray[np.float64],
    transform: str = "CAT16",
    luminance: Literal["lamp", "keep"] = "lamp",
) -> npt.NDArray[np.float64]:
    """Return the working RGB → working RGB matrix that adapts the white `source_rgb` to `destination_rgb`.

    Property: with ``luminance="lamp"``, ``matrix @ source_rgb == destination_rgb`` to rounding.

    Parameters
    ----------
    source_rgb, destination_rgb
        Shape (3,). Linear working RGB of the two whites; a lamp of D65 has the destination (1, 1, 1).
    xyz_from_rgb
        Shape (3, 3). The working space; its middle row is luminance.
    transform
        One of `TRANSFORMS`.
    luminance
        ``"lamp"`` maps the source exactly onto the destination, so the lamp becomes the unit of radiance.
        ``"keep"`` changes the chromaticity only: the source keeps its luminance, hence 1.0 stays what it was.

    Raises
    ------
    CalibrateError
        For an unknown transform, and for a white with a cone response that is not positive: no gain exists then.
    """
    source = np.asarray(source_rgb, dtype=np.float64)
    destination = np.asarray(destination_rgb, dtype=np.float64)
    cone_from_rgb = cone_matrix(transform, xyz_from_rgb)
    source_cones = _positive_cones(cone_from_rgb, source, transform, "source (the lamp)")
    destination_cones = _positive_cones(cone_from_rgb, destination, transform, "destination")
    if luminance == "keep":
        luminance_row = np.asarray(xyz_from_rgb, dtype=np.float64)[1]
        source_y, destination_y = float(luminance_row @ source), float(luminance_row @ destination)
        if source_y <= 0 or destination_y <= 0:
            raise CalibrateError(
                f"balance.luminance: luminance {source_y:.4g} of the source and {destination_y:.4g} of the destination; "
                "both must be positive to be kept. Set `balance.luminance: lamp` or point `balance.lamp` at the lamp."
            )
        destination_cones = destination_cones * (source_y / destination_y)
    elif luminance != "lamp":
        raise CalibrateError(
            f"balance.luminance: {luminance!r} is unknown; expected 'lamp' or 'keep'. Set `balance.luminance: lamp`."
        )
    gains = destination_cones / source_cones
    return np.asarray(np.linalg.solve(cone_from_rgb, gains[:, None] * cone_from_rgb))


def _positive_cones(
    cone_from_rgb: npt.NDArray[np.float64], rgb: npt.NDArray[np.float64], transform: str, role: str
) -> npt.NDArray[np.float64]:
    cones = np.asarray(cone_from_rgb @ rgb)
    if rgb.shape == (3,) and np.isfinite(rgb).all() and (cones > 0).all():
        return cones
    values = ", ".join(f"{value:.4g}" for value in np.ravel(rgb))
    responses = ", ".join(f"{value:.4g}" for value in np.ravel(cones))
    raise CalibrateError(
        f"balance.transform: {role} RGB ({values}) has the responses ({responses}) in the space {transform!r}; "
        "all three must be positive and finite. Point `balance.lamp` at the D65 module, or set another "
        "`balance.transform` (CAT16 is positive for every real light)."
    )
