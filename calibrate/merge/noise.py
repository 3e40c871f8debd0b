"""The noise of a camera that nobody has measured."""

from calibrate.exposure import FrameInfo
from calibrate.merge.records import NoiseModel

# What a typical sensor of 4–6 µm photosites has at ISO 100 (SENSOR_READ includes the converter).
_FULL_WELL_E = 50_000.0
_SENSOR_READ_E = 3.0


def guess_noise(info: FrameInfo) -> NoiseModel:
    """Return the noise model of a typical sensor, scaled to a frame's levels and ISO.

    A well of 50 000 electrons at the white level at ISO 100, inversely proportional to ISO, and 3 electrons of read
    noise. It is a guess that only ranks the samples of a pixel: the result is unbiased whatever the model, and a model
    that is wrong by a factor of two costs a few per cent of noise. Do not report it as a property of the camera.
    """
    span = (sum(info.white_dn) - sum(info.black_dn)) / len(info.white_dn)
    return NoiseModel(_FULL_WELL_E / span * 100.0 / (info.iso or 100.0), _SENSOR_READ_E)
