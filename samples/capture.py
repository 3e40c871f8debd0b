"""A bracket of RAW frames of a synthetic place, and writing it as DNG.

capture = make_capture(CaptureSettings(width=512, seed=3))
capture.frames[0].mosaic        # uint16 [H, W]
capture.truth().camera_rgb      # what a perfect camera would have found
write_capture(folder, capture)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

from samples import spectra
from samples.dng import encode_dng
from samples.places import Furnace, Room
from samples.projection import LatLong, Pinhole
from samples.sensor import Camera, Counts, Float64, expose
from samples.truth import Truth, truth_of
from samples.view import View, look


def bracket(longest_s: Fraction, frames: int, *, step_ev: int = 2) -> tuple[Fraction, ...]:
    """Return exposure times, shortest first, `step_ev` apart."""
    return tuple(longest_s / 2 ** (step_ev * k) for k in reversed(range(frames)))


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """What to photograph and how. The defaults, at a width of 1280, are the shipped capture.

    `height` 0 is half the width. `perspective` replaces the lat-long view. `name` starts the files' names.
    """

    place: Room | Furnace = field(default_factory=Room)
    width: int = 1280
    height: int = 0
    perspective: Pinhole | None = None
    exposures_s: tuple[Fraction, ...] = bracket(Fraction(8), 7)
    camera: Camera = field(default_factory=Camera)
    seed: int = 20260101
    sub: int = 2
    name: str = "room"

    @property
    def projection(self) -> LatLong | Pinhole:
        """Return the projection of the view."""
        return self.perspective or LatLong(self.width, self.height)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One RAW frame: `mosaic` uint16 [H, W], counts with the black level in them."""

    name: str
    mosaic: Counts
    exposure_s: Fraction
    camera: Camera


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """A bracket with the place it shows; `rgb` (H, W, 3) is its noise-free camera RGB per second."""

    settings: CaptureSettings
    frames: tuple[Frame, ...]
    rgb: Float64
    view: View

    def truth(self, *, spectral: bool = False) -> Truth:
        """Return what is true of the capture; with `spectral` the cube of radiance too."""
        return truth_of(self.view, self.settings.camera, spectral=spectral)


@lru_cache(maxsize=4)
def make_capture(settings: CaptureSettings | None = None) -> Capture:
    """Return the bracket of `settings`; equal settings give the same bits. Cached, so its arrays are read-only."""
    settings = settings or CaptureSettings()
    view = look(settings.place, settings.projection, sub=settings.sub)
    rgb = view.response(settings.camera.responses)
    frames = tuple(
        Frame(
            f"{settings.name}_{index + 1:02d}.dng",
            expose(rgb, exposure_s, camera=settings.camera, seed=settings.seed, frame=index),
            exposure_s,
            settings.camera,
        )
        for index, exposure_s in enumerate(settings.exposures_s)
    )
    rgb.setflags(write=False)
    for frame in frames:
        frame.mosaic.setflags(write=False)
    return Capture(settings, frames, rgb, view)


def encode_frame(frame: Frame, *, compressed: bool = False) -> bytes:
    """Return a frame as the bytes of a DNG, its white balance set for D65."""
    neutral = frame.camera.white_balance(spectra.lamp("D65"))
    return encode_dng(frame.mosaic, frame.exposure_s, camera=frame.camera, neutral=neutral, compressed=compressed)


def write_capture(folder: Path, capture: Capture, *, compressed: bool = False) -> tuple[Path, ...]:
    """Write the frames of a capture into `folder`, which is made if need be; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for frame in capture.frames:
        path = folder / frame.name
        path.write_bytes(encode_frame(frame, compressed=compressed))
        paths.append(path)
    return tuple(paths)
