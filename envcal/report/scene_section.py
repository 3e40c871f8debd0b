"""The rendered scene on the page: what `envcal mitsuba` left under mitsuba/ in the output folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, ValidationError

from envcal.errors import EnvcalError
from envcal.report import previews

FOLDER, FIGURES = "mitsuba", "figures.json"
#: Pictures wider than this are made smaller.
_WIDEST = 960


class _Difference(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    mean: float
    p95: float
    max: float
    noise: float
    outside: float = 0.0
    outside_mean: float = 0.0


class _Figures(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    uplift: str
    variant: str
    width: int
    height: int
    spp: int
    exposure_stops: float
    difference: _Difference


def scene(output: Path, uplift_digest: str | None) -> dict[str, Any] | None:
    """The two renders, their difference and the figures; None where there are none.

    `uplift_digest` is that of the run's uplift file: pictures of another one are pointed out.
    """
    folder = output / FOLDER
    path = folder / FIGURES
    if not path.is_file():
        return None
    try:
        figures = _Figures.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, ValidationError) as error:
        first = str(error).splitlines()[0]
        raise EnvcalError(f"{path}: is damaged ({first}). Run `envcal mitsuba` again.") from None
    return {
        "figures": figures,
        "stale": uplift_digest is not None and uplift_digest != figures.uplift,
        "pictures": {
            name: previews.jpeg(_picture(folder / f"{name}.png"), quality=90) for name in ("uplift", "scaled")
        },
        "difference": previews.jpeg(_picture(folder / "difference.png"), quality=90),
    }


def _picture(path: Path) -> npt.NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise EnvcalError(f"{path}: cannot be read. Run `envcal mitsuba` again.")
    if image.shape[1] > _WIDEST:
        height = round(image.shape[0] * _WIDEST / image.shape[1])
        image = cv2.resize(image, (_WIDEST, height), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(image[..., ::-1]).astype(np.uint8)
