"""The low sun's sky from the Prague sky model's data file, for those who have it.

Model: A. Wilkie et al., "A Fitted Radiance and Attenuation Model for Realistic Atmospheres", ACM Trans. Graph. 40(4), 2021;
P. Vévoda et al., "A Wide Spectral Range Sky Radiance Model", Computer Graphics Forum 41(7), 2022. The radiance of a clear sky
is, for every configuration of visibility, ground albedo, altitude, sun elevation and wavelength channel, a sum over `rank`
of products of two piecewise linear functions, of the angle to the sun and of the angle to the zenith, times a third one of
the angle to the zenith.

Layout of the file, little-endian: for visibilities (km), albedos, altitudes (m) and elevations (degrees) in turn a count
(int32) and that many float64; number of channels (int32), their start and width in nm (float64); rank (int32); for the
breaks over the sun's angle, the zenith's and the last function (all in radians) a count and the float64 values. Then all
configurations, channels running fastest and visibilities slowest, each: `rank` times (float16 at the sun's breaks, a
float64 divisor, float16 at the zenith's breaks), and float16 at the last function's breaks. What follows (transmittance,
polarisation) is not read.

As in Tódová and Wilkie (EGSR 2024), a sunset of a CCT is the brightest place of the sky under a sun 0 to 20 degrees high, in
the clearest air of the file, over black ground at the lowest altitude. The disc of the sun is not part of it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.illuminants.nodes import Node, check_range, interpolated, nodes_of
from uplift.spectrum import Observer, normalised

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

ELEVATIONS_DEG = np.arange(0.0, 20.5, 1.0)
MOST = 4096  # of anything that the header counts; real files have at most some dozens
PLANET_M, SAFETY_M = 6_378_000.0, 50.0  # the authors move the observer up by 50 m
VISIBLE_NM = (400.0, 700.0)


@dataclass(frozen=True, slots=True, eq=False)
class PragueSky:
    """The clear sky of a data file: one visibility, albedo and altitude."""

    elevations_deg: Floats  # [E]
    channels_nm: Floats  # [C] middles
    sun: Floats  # [E, C, rank, sun breaks]
    zenith: Floats  # [E, C, rank, zenith breaks]
    emphasis: Floats  # [E, C, last breaks]
    sun_breaks: Floats
    zenith_breaks: Floats
    emphasis_breaks: Floats

    def radiance(self, elevation_deg: float, theta: Floats, azimuth: Floats) -> Floats:
        """Return the sky's radiance [..., C] at zenith angles and azimuths from the sun [...], in radians.

        The elevation is taken within those of the file.
        """
        height = float(np.clip(elevation_deg, self.elevations_deg[0], self.elevations_deg[-1]))
        upper = int(np.clip(np.searchsorted(self.elevations_deg, height), 1, max(len(self.elevations_deg) - 1, 1)))
        if len(self.elevations_deg) == 1:
            return self._at(0, height, theta, azimuth)
        low, high = self.elevations_deg[upper - 1 : upper + 1]
        part = (height - low) / (high - low)
        here = (1.0 - part) * self._at(upper - 1, height, theta, azimuth)
        out: Floats = here + part * self._at(upper, height, theta, azimuth)
        return out

    def _at(self, index: int, elevation_deg: float, theta: Floats, azimuth: Floats) -> Floats:
        elevation = np.radians(elevation_deg)
        cosine = np.cos(theta) * np.sin(elevation) + np.sin(theta) * np.cos(elevation) * np.cos(azimuth)
        gamma = np.arccos(np.clip(cosine, -1.0, 1.0))
        away = PLANET_M + SAFETY_M
        lift = np.sqrt(away**2 - PLANET_M**2) / away  # of the view, as the authors correct for the altitude
        zero = np.arctan2(np.sin(theta), np.cos(theta) + lift)
        along_sun = _piecewise(gamma, self.sun_breaks, self.sun[index])
        along_zenith = _piecewise(zero, self.zenith_breaks, self.zenith[index])
        product = (along_sun * along_zenith).sum(axis=1)  # over the rank: [C, ...]
        found = np.maximum(product * _piecewise(zero, self.emphasis_breaks, self.emphasis[index]), 0.0)
        return np.moveaxis(found, 0, -1)


def _piecewise(at: Floats, breaks: Floats, values: Floats) -> Floats:
    """Linear between `breaks` [B], of `values` [..., B], at points of any shape: [..., *points]."""
    within = np.clip(at, breaks[0], breaks[-1])
    upper = np.clip(np.searchsorted(breaks, within, side="right"), 1, len(breaks) - 1)
    part = (within - breaks[upper - 1]) / (breaks[upper] - breaks[upper - 1])
    out: Floats = values[..., upper - 1] * (1.0 - part) + values[..., upper] * part
    return out


class _Reader:
    """Numbers of the header, one after the other."""

    def __init__(self, data: Bytes, place: str) -> None:
        self.data, self.place, self.at = data, place, 0

    def take(self, size: int, what: str) -> bytes:
        if self.at + size > len(self.data):
            raise UpliftError(
                f"{self.place}: ends within its {what}; expected the whole data file of the Prague sky model. Download it again."
            )
        self.at += size
        return self.data[self.at - size : self.at].tobytes()

    def count(self, what: str, least: int = 1) -> int:
        value = int(struct.unpack("<i", self.take(4, what))[0])
        if not least <= value <= MOST:
            raise UpliftError(
                f"{self.place}: {value} {what}; expected {least} to {MOST}. Is it a data file of the Prague sky model (.dat)?"
            )
        return value

    def values(self, count: int, what: str) -> Floats:
        found = np.frombuffer(self.take(8 * count, what), "<f8").astype(np.float64)
        if not np.isfinite(found).all() or (np.diff(found) <= 0).any():
            raise UpliftError(f"{self.place}: its {what} do not rise; expected a data file of the Prague sky model")
        return found


def read_prague(data: Bytes, *, place: str = "Prague sky model") -> PragueSky:
    """Return the clear sky over black ground of a data file, `data` [bytes] uint8; a memory map is read in part only.

    Raises UpliftError if the bytes are not of the layout, end early, or hold no visible channels.
    """
    reader = _Reader(data, place)
    axes = [
        reader.values(reader.count(what), what) for what in ("visibilities", "albedos", "altitudes", "sun elevations")
    ]
    channels = reader.count("channels")
    start, width = struct.unpack("<dd", reader.take(16, "channels"))
    if not (np.isfinite(start) and 0 < width < 1000 and start >= 0):
        raise UpliftError(
            f"{place}: channels of {width:g} nm from {start:g} nm; expected some 40 nm from 280 or 320 nm"
        )
    middles = start + width * (np.arange(channels) + 0.5)
    if middles[0] - width / 2 > VISIBLE_NM[0] or middles[-1] + width / 2 < VISIBLE_NM[1]:
        raise UpliftError(f"{place}: channels end at {middles[-1]:g} nm; expected them to cover 400 to 700 nm")
    rank = reader.count("products")
    breaks = [reader.values(reader.count(what, 2), what) for what in ("sun breaks", "zenith breaks", "last breaks")]
    sun, zenith, last = (len(one) for one in breaks)
    one = np.dtype([("sun", "<f2", (sun,)), ("scale", "<f8"), ("zenith", "<f2", (zenith,))])
    configuration = np.dtype([("terms", one, (rank,)), ("last", "<f2", (last,))])
    visibilities, albedos, altitudes, elevations = (len(axis) for axis in axes)
    per_sky = elevations * channels
    whole = visibilities * albedos * altitudes * per_sky * configuration.itemsize
    if reader.at + whole > len(data):
        raise UpliftError(
            f"{place}: has {len(data) - reader.at} bytes of coefficients; expected {whole}. Download the file again."
        )
    # the clearest air (last), albedo and altitude first
    skip = (visibilities - 1) * albedos * altitudes * per_sky * configuration.itemsize
    part = data[reader.at + skip : reader.at + skip + per_sky * configuration.itemsize].tobytes()
    table = np.frombuffer(part, configuration).reshape(elevations, channels)
    scale = table["terms"]["scale"]
    if not np.isfinite(scale).all() or (scale == 0).any():
        raise UpliftError(f"{place}: a divisor of its coefficients is 0 or not a number. Download the file again.")
    return PragueSky(
        axes[3],
        middles,
        table["terms"]["sun"].astype(np.float64),
        table["terms"]["zenith"].astype(np.float64) / scale[..., np.newaxis],
        table["last"].astype(np.float64),
        *breaks,
    )


def prague_nodes(sky: PragueSky, observer: Observer) -> tuple[Node, ...]:
    """Return the brightest place of the sky under suns 0 to 20 degrees high, as spectra ascending in CCT.

    Linear between the middles of the channels, the end values held. Raises UpliftError if no elevation of the file is in reach.
    """
    theta, azimuth = np.meshgrid(
        np.radians(np.arange(0.5, 90.0, 1.0)), np.radians(np.arange(0.0, 181.0, 3.0)), indexing="ij"
    )
    to_grid = np.stack(
        [np.interp(observer.wavelengths_nm, sky.channels_nm, row) for row in np.eye(len(sky.channels_nm))]
    )
    spectra = []
    lowest, highest = sky.elevations_deg[[0, -1]]
    for elevation in ELEVATIONS_DEG:
        if not lowest <= elevation <= highest:
            continue
        found = sky.radiance(float(elevation), theta, azimuth).reshape(-1, len(sky.channels_nm))
        brightest = found[int(np.argmax(found @ (to_grid @ observer.cmfs[:, 1])))]
        if brightest.max() > 0:
            spectra.append((f"sun at {elevation:g} degrees", normalised(brightest @ to_grid, observer)))
    nodes = tuple(node for node in nodes_of(spectra, observer) if np.isfinite(node.cct))
    if len(nodes) < 2:
        raise UpliftError(
            "Prague sky model: holds no sky under a sun 0 to 20 degrees high; use one of the full data files"
        )
    return nodes


def prague_sunset(nodes: tuple[Node, ...], cct: float, observer: Observer) -> Floats:
    """Return the emission [N], Y = 1, of the sky whose CCT is `cct`, between those of `nodes`.

    Raises UpliftError outside that range.
    """
    check_range("sunset", cct, nodes[0].cct, nodes[-1].cct, "The sky of the data file has no such place.")
    return interpolated(nodes, cct, observer)
