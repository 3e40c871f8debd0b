"""How often the kind of lamp is right, and whether it is as probable as it was said to be."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.spectrometer.lamps import EYES, Float64, Tested
from benchmarks.spectrometer.readings import model_without, prior_without, read
from uplift.spectrometer import FAMILIES, measure_light


def kinds(every: list[Tested], chosen: list[int], curves: Float64, *, known: bool) -> dict[str, Any]:
    """The family that each lamp is taken for with each camera, and how probable it was said to be."""
    truth, found, misfits = [], [], []
    refused = dict.fromkeys(chosen, 0)
    models = {} if known else {k: model_without(curves, k) for k in chosen}
    for number, lamp in enumerate(every):
        prior = prior_without(lamp)
        for camera in chosen:
            reading = read(lamp.emission, curves[camera], seed=1000 * number + camera)
            instrument = curves[camera] if known else models[camera]
            light = measure_light(reading, camera=instrument, observer=EYES, prior=prior)
            truth.append(FAMILIES.index(lamp.family))
            found.append([light.families[name] for name in FAMILIES])
            misfits.append(light.chi2)
            refused[camera] += bool(light.refused)
    return {
        **judged_kinds(np.array(truth), np.array(found)),
        "lamps": len(every),
        "largest_chi2": max(misfits),
        "refused": sum(refused.values()),
        "refused_of_camera": refused,
    }


def judged_kinds(truth: npt.NDArray[np.int64], found: Float64) -> dict[str, Any]:
    """How often the most probable family was right [S] by the probabilities `found` [S, 5], and whether these are true.

    `ece` is the expected calibration error over 15 bins of equal width (C. Guo et al., "On calibration of modern neural
    networks", ICML 2017); `log_loss` the mean of -log of the right family's probability.
    """
    right, surest = found.argmax(axis=1) == truth, found.max(axis=1)
    bins, ece = [], 0.0
    for k in range(15):
        inside = (surest > k / 15) & (surest <= (k + 1) / 15)
        if inside.any():
            ece += float(inside.mean() * abs(surest[inside].mean() - right[inside].mean()))
    for low, high in (
        (0.2, 0.5),
        (0.5, 0.6),
        (0.6, 0.7),
        (0.7, 0.8),
        (0.8, 0.9),
        (0.9, 0.97),
        (0.97, 0.995),
        (0.995, 1.01),
    ):
        inside = (surest >= low) & (surest < high)
        if inside.any():
            bins.append([float(surest[inside].mean()), float(right[inside].mean()), int(inside.sum())])
    by_family = {
        name: [float(right[truth == k].mean()), int((truth == k).sum())]
        for k, name in enumerate(FAMILIES)
        if (truth == k).any()
    }
    said = np.maximum(found[np.arange(truth.size), truth], 1e-12)
    return {
        "readings": truth.size,
        "right": by_family,
        "reliability": bins,
        "ece": ece,
        "log_loss": float(-np.log(said).mean()),
    }
