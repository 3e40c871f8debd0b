"""What a measured spectrum is worth: rooms lit by the lamp, relit with the spectrum that the chart measured."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import rooms as relit
from benchmarks.spectrometer.lamps import EYES, Float64, Tested
from benchmarks.spectrometer.readings import model_without, prior_without, read
from uplift.spectrometer import measure_light
from uplift.spectrum import rgb_space

SPACE = rgb_space("ITU-R BT.2020")


def relights(
    folder: Path, every: list[Tested], chosen: list[int], curves: Float64, each: int
) -> Iterator[dict[str, Any]]:
    """Relight errors of each lamp with `each` cameras: scaled, with the true and with the measured spectra."""
    places, models = relit.rooms(folder, EYES), {k: model_without(curves, k) for k in chosen}
    surfaces = relit.atlas(folder, EYES)
    context = {"observer": EYES, "space": SPACE}
    for number, lamp in enumerate(every):
        source = relit.Lamp(lamp.family, lamp.name, lamp.emission, 0.0, 0.0, in_library=False)
        scenes = [relit.lit(room, dict.fromkeys(range(3), (source, 1.0)), count=100, **context) for room in places]  # type: ignore[arg-type]
        labels = [np.zeros(scene.rgb.shape[:2], np.uint32) for scene in scenes]
        scaled = [relit.scaled_error(scene, surfaces, **context) for scene in scenes]  # type: ignore[arg-type]

        def errors(emission: Float64, scenes: Any = scenes, labels: Any = labels) -> list[float]:
            pairs = zip(scenes, labels, strict=True)
            return [relit.error(scene, own, [emission], surfaces, **context) for scene, own in pairs]  # type: ignore[arg-type]

        true = errors(lamp.emission)
        for turn in range(each):
            camera = chosen[(number + turn * 3) % len(chosen)]
            reading = read(lamp.emission, curves[camera], seed=1000 * number + camera)
            prior = prior_without(lamp)
            found = {
                "known": measure_light(reading, camera=curves[camera], observer=EYES, prior=prior),
                "unknown": measure_light(reading, camera=models[camera], observer=EYES, prior=prior),
            }
            row: dict[str, Any] = {
                "family": lamp.family,
                "name": lamp.name,
                "camera": camera,
                "scaled": scaled,
                "true": true,
            }
            for key, light in found.items():
                # What was refused is not used: the light then has no better spectrum than the scaled uplift gives it.
                row[key] = scaled if light.refused else errors(light.emission)
                row[f"{key}_refused"] = bool(light.refused)
                row[f"{key}_sure"] = light.camera_loss
            yield row
