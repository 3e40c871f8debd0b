"""What the choice of the families' temper and of the weight of LEDs is worth on lamps that it has not seen.

`python -m benchmarks spectrometer --only held-out`. The lamps of each family are parted in two halves. On either half that
temper and weight are chosen that have the least log loss among those with which each family is right as often as asked
(`ASKED`; among all, if there is none), and judged on the other half. The spectrum itself depends on neither.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.spectrometer.kinds import judged_kinds
from benchmarks.spectrometer.lamps import EYES, Float64, Tested
from benchmarks.spectrometer.readings import prior_without, read
from uplift.spectrometer import FAMILIES, chart_reflectances
from uplift.spectrometer.fit import fit
from uplift.spectrometer.posterior import FAMILY_TEMPER, LED_LIKELIER, family_probabilities
from uplift.spectrometer.prior import Prior

TEMPERS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
LIKELIER = (1.0, 4 / 3, 5 / 3, 2.0)
ASKED = {"led": 0.97, "incandescent": 0.90, "daylight": 0.85, "fluorescent": 0.75}


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """One reading: the lamp's number and family, and the misfits of the Gaussians of the prior it was measured with."""

    lamp: int
    family: int
    misfit: Float64
    prior: Prior


def measured(every: Sequence[Tested], cameras: Sequence[int], curves: Float64) -> list[Measured]:
    """Every lamp with every camera, sensitivities known."""
    out = []
    for number, lamp in enumerate(every):
        prior = prior_without(lamp)
        for camera in cameras:
            reading = read(lamp.emission, curves[camera], seed=1000 * number + camera)
            found = fit(reading, chart_reflectances(EYES), curves[camera], prior, EYES)
            out.append(Measured(number, FAMILIES.index(lamp.family), found.posterior.misfit, prior))
    return out


def held_out(readings: Sequence[Measured]) -> dict[str, Any]:
    """What was chosen on each half, and how good it is on the other; `shipped` is judged on all and has seen all."""
    truth = np.array([reading.family for reading in readings])
    second = _second_half(np.array([reading.lamp for reading in readings]), truth)
    tried = {
        (temper, likelier): np.array([family_probabilities(r.misfit, r.prior, temper, likelier) for r in readings])
        for temper, likelier in itertools.product(TEMPERS, LIKELIER)
    }
    unseen, chosen = np.empty((truth.size, len(FAMILIES))), []
    for own in (~second, second):
        best = min(tried, key=lambda key, own=own: _loss(truth[own], tried[key][own]))  # type: ignore[misc]
        chosen.append(best)
        unseen[~own] = tried[best][~own]
    return {
        "chosen": chosen,
        "held_out": judged_kinds(truth, unseen),
        "halves": [judged_kinds(truth[~own], unseen[~own]) for own in (~second, second)],
        "shipped": judged_kinds(truth, tried[FAMILY_TEMPER, LED_LIKELIER]),
    }


def _second_half(lamps: npt.NDArray[np.int64], truth: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Whether a reading [S] belongs to the second half of its family's lamps, drawn by lot."""
    chance = np.random.default_rng(7)
    out = np.zeros(lamps.size, bool)
    for family in np.unique(truth):
        own = np.unique(lamps[truth == family])
        chance.shuffle(own)
        out |= np.isin(lamps, own[own.size // 2 :])
    return out


def _loss(truth: npt.NDArray[np.int64], found: Float64) -> tuple[bool, float]:
    judged = judged_kinds(truth, found)
    short = any(judged["right"].get(name, (1.0, 0))[0] < least for name, least in ASKED.items())
    return short, judged["log_loss"]
