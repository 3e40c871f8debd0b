"""The lamp in the reference shot: what is known of it, where it is, and what it reads."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.config import BalanceSettings, LampForm, LampOnChart, LampRectangle
from envcal.errors import EnvcalError
from envcal.profile import Profile

if TYPE_CHECKING:
    from calibrate.lamp import ExpectedColour
    from calibrate.lamp import Lamp as Reading
    from uplift.spectrum import Observer

Floats = npt.NDArray[np.float64]

#: By how much, relative to each other, a camera's channels differ from its model's published D65 matrix, and from sensitivities that
#: were measured of it or of another of its model.
_MATRIX_SPREAD, _SENSITIVITIES_SPREAD = 0.03, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class KnownLamp:
    """What the settings say of lamp and camera: the lamp's `spectrum` and `daylight` [N], its `xyz` [3], and the camera's
    `sensitivities` [N, 3] or None; `measured` is the spectrum if it is the lamp's own.
    """

    observer: Observer
    daylight: Floats
    spectrum: Floats
    xyz: Floats
    sensitivities: Floats | None
    measured: Floats | None

    @classmethod
    def of(cls, settings: BalanceSettings, folder: Path) -> KnownLamp:
        """Read the files that the settings name."""
        from envcal.cameras import sensitivities
        from envcal.spd import read_spd
        from envcal.steps.chart_light import place_of
        from uplift.illuminants import measured_emission
        from uplift.spectrum import illuminant, observer, xyz_of

        seen = observer()
        measured = None
        if settings.spectrum is not None:
            path = folder / settings.spectrum
            measured = measured_emission(*read_spd(path), seen, name=str(path))
        daylight = illuminant("D65", seen)
        spectrum = daylight if measured is None else measured
        curves = None
        if settings.camera is not None:
            curves = sensitivities(place_of(settings.camera, folder), seen.wavelengths_nm)
        return cls(seen, daylight, spectrum, xyz_of(spectrum, seen), curves, measured)

    def expected(self, header: exr.Header, profile: Profile) -> ExpectedColour | None:
        """The colour that the camera should see: by its sensitivities, else by its published matrix, else None."""
        from calibrate.lamp import ExpectedColour

        # Root terms are of no account for a colour that is expected to a percent only.
        matrix = np.asarray(profile.matrix, np.float64)
        if self.sensitivities is not None:
            seen = np.asarray(self.spectrum @ self.sensitivities)
            return ExpectedColour(seen, matrix, _SENSITIVITIES_SPREAD, own_spectrum=self.measured is not None)
        if "envcalCameraFromXYZ" not in header.attributes:
            return None
        seen = np.asarray(np.asarray(header.json("envcalCameraFromXYZ"), np.float64) @ self.xyz)
        return ExpectedColour(seen, matrix, _MATRIX_SPREAD)


def read_in_view(
    header: exr.Header,
    image: npt.NDArray[np.float32],
    profile: Profile,
    settings: BalanceSettings,
    lamp: KnownLamp,
    *,
    xyz_from_rgb: Floats,
) -> Reading:
    """The lamp in one picture in working RGB: where the settings say, else the one found."""
    from calibrate.lamp import ExpectedForm, find_lamp

    expected = lamp.expected(header, profile)
    if isinstance(settings.lamp, LampRectangle | LampOnChart):
        return _read_named(image, profile, settings.lamp, header, xyz_from_rgb=xyz_from_rgb, expected=expected)
    form = None
    if isinstance(settings.lamp, LampForm):
        form = ExpectedForm(settings.lamp.size, settings.lamp.within)
    return find_lamp(
        image,
        chart_corners=np.asarray(profile.chart.corners, np.float64),
        xyz_from_rgb=xyz_from_rgb,
        expected=expected,
        form=form,
        latlong=_is_latlong(header),
    )


def read_in_difference(
    pair: tuple[Path, Path], profile: Profile, settings: BalanceSettings, *, xyz_from_rgb: Floats
) -> Reading:
    """The lamp in the difference of two merged pictures, lamp on and lamp off."""
    from calibrate.correct import apply_matrix
    from calibrate.lamp import find_lit_lamp, lamp_alone

    (header, on, sigma_on), (_, off, sigma_off) = (_read_merged(path) for path in pair)
    white = np.asarray(profile.chart.white.camera_rgb)
    alone = lamp_alone(on, off, sigma_on=sigma_on, sigma_off=sigma_off, white_rgb=white)
    working = apply_matrix(alone.light, profile.full_matrix())
    if isinstance(settings.lamp, LampRectangle | LampOnChart):
        lamp = _read_named(working, profile, settings.lamp, header, xyz_from_rgb=xyz_from_rgb, alone=True)
    else:
        lamp = find_lit_lamp(alone, working, xyz_from_rgb=xyz_from_rgb, latlong=_is_latlong(header))
    return dataclasses.replace(lamp, warnings=(*alone.warnings, *lamp.warnings))


def _read_named(
    image: npt.NDArray[np.float32],
    profile: Profile,
    place: LampRectangle | LampOnChart,
    header: exr.Header,
    *,
    xyz_from_rgb: Floats,
    expected: ExpectedColour | None = None,
    alone: bool = False,
) -> Reading:
    """The lamp where the settings say that it is; `alone`: the picture holds no other light."""
    from calibrate.lamp import measure_lamp, rectangle_from_chart

    polygon = None
    if isinstance(place, LampOnChart):
        polygon = rectangle_from_chart(place.chart_rectangle, np.asarray(profile.chart.corners, np.float64))
    return measure_lamp(
        image,
        polygon,
        rectangle=place.rectangle if isinstance(place, LampRectangle) else None,
        xyz_from_rgb=xyz_from_rgb,
        latlong=_is_latlong(header),
        expected=expected,
        alone=alone,
    )


def _is_latlong(header: exr.Header) -> bool:
    return header.size[1] == 2 * header.size[0]


def _read_merged(path: Path) -> tuple[exr.Header, npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    header, image = exr.read_rgb(path)
    names = [f"sigma.{channel}" for channel in "RGB"]
    if header.attributes.get("envcalSpace") != provenance.CAMERA_RGB or any(n not in header.channels for n in names):
        raise EnvcalError(
            f"{path}: is no merged bracket with its noise, which the difference of lamp on and lamp off needs. Make it with "
            "`envcal merge FRAME… -o merged.exr --set deviation=true`."
        )
    _, planes = exr.read(path, [*names, "lost"])
    # Lost light may have been filled with what nobody measured.
    image = np.where(planes["lost"][..., None] > 0, np.float32(np.nan), image)
    return header, image, np.stack([planes[name] for name in names], axis=2)
