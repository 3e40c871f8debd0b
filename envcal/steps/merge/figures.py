"""What is told of a merge: the figures of the run, and what the file says of the camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal.profile import Camera
from envcal.steps.merge.bracket import Bracket

if TYPE_CHECKING:
    from calibrate.exposure import FrameInfo
    from calibrate.merge import Measured, Merged


def camera_of(infos: Sequence[FrameInfo]) -> Camera:
    """Return the camera of a bracket; mixed ones are merged in units of the lowest ISO and the smallest opening."""
    first = infos[0]
    return Camera(
        model=first.camera,
        lens=first.lens,
        iso=min((one.iso for one in infos if one.iso), default=None),
        f_number=max((one.f_number for one in infos if one.f_number), default=None),
        focal_length_mm=first.focal_length_mm,
    )


def figures_of(bracket: Bracket, lost: npt.NDArray[np.bool_], share: float) -> dict[str, Any]:
    """Return what was measured of a bracket and what became of it; `lost` is the mask of the image, `share` its size."""
    merged, measured = bracket.merged, bracket.measured
    return {
        "size": [lost.shape[1], lost.shape[0]],
        "cfa": merged.cfa,
        "frames": _frame_figures(merged, measured, lost.size),
        "lost": int(lost.sum()),
        "lost_share": share,
        "defects": merged.defect_count,
        "gain_e_per_dn": float(merged.noise.gain_e_per_dn),
        "read_noise_e": float(merged.noise.read_noise_e),
        "noise_from": measured.noise_from,
        "black_from": measured.black_from,
        "black_shift_dn": measured.black_shift_dn,
        "shifts": [[float(v) for v in d.shift] if d.moved else [0.0, 0.0] for d in bracket.displaced],
        "ghosts": bracket.left_out,
        "clip_from": measured.clip_from,
        "clip_dn": of_colours(measured.exposures[0].clip, merged.cfa),
    }


def of_colours(values: npt.NDArray[np.float64], cfa: str) -> list[float]:
    """Return the smallest value of each of red, green and blue."""
    if cfa == "W":
        return [float(values[0])] * 3
    return [min(float(v) for v, c in zip(values, cfa, strict=True) if c == colour) for colour in "RGB"]


def _frame_figures(merged: Merged, measured: Measured, pixels: int) -> list[Mapping[str, Any]]:
    ratios = dict(zip(measured.names, measured.ratios, strict=True))
    return [
        {
            "name": Path(use.name).name,
            "exposure_s": float(use.exposure_s),
            "exposure": str(use.exposure_s),
            "clipped": use.clipped / pixels,
            "share": use.share,
            "factor": ratios[use.name].factor,
            "factor_error": ratios[use.name].error if np.isfinite(ratios[use.name].error) else None,
            "factor_used": ratios[use.name].applied,
            "uneven": ratios[use.name].uneven,
        }
        for use in merged.frames
    ]
