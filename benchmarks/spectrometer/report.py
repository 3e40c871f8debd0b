"""The figures as text."""

from __future__ import annotations

from typing import Any

import numpy as np

from uplift.spectrometer import FAMILIES
from uplift.spectrometer.refusal import MOST_CHI2

#: A map relit so many times as wrongly as by the scaled uplift was done harm.
HARM = 1.2


def gmean(values: Any) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(np.asarray(values)))))


def report(figures: dict[str, Any]) -> str:
    """Return the figures as text."""
    lines = _relight(figures["relight"]) if figures.get("relight") else []
    for key in ("kinds_known", "kinds_unknown"):
        if key in figures:
            lines += _kinds(key, figures[key])
    if "held_out" in figures:
        lines += _held_out(figures["held_out"])
    for case, (rightly, count) in figures.get("refusals", {}).items():
        lines.append(f"refusal of {case}: named rightly {rightly} of {count}")
    for change, own in figures.get("odd_cameras", {}).items():
        ratios = np.array(own["ratios"])
        lines.append(
            f"camera {change}: {ratios.size} readings, {sum(own['refused'].values())} refused {own['refused'] or ''}, relight error ÷ that "
            f"of the scaled uplift {gmean(ratios):.3f}, worst {ratios.max():.2f}, above {HARM}: {(ratios > HARM).sum()}"
        )
    return "\n".join(lines)


def _relight(rows: list[dict[str, Any]]) -> list[str]:
    scaled = np.array([row["scaled"] for row in rows])
    ratios = {key: np.array([row[key] for row in rows]) / scaled for key in ("true", "known", "unknown")}
    floor, too_much = gmean(ratios["true"]), ratios["true"] > HARM
    lines = [
        f"relight error ÷ that of the scaled uplift, {len({r['name'] for r in rows})} lamps, "
        f"{len({r['camera'] for r in rows})} cameras, {scaled.size} maps:"
    ]
    for key, ratio in ratios.items():
        lines.append(
            f"  {key:8} geometric mean {gmean(ratio):.3f}, gain of the true spectrum {(1 - gmean(ratio)) / (1 - floor):.0%}, "
            f"worst {ratio.max():.2f}; maps above {HARM}: {(ratio > HARM).sum()}, of which the true spectrum is too: "
            f"{((ratio > HARM) & too_much).sum()}"
        )
        for family in FAMILIES:
            own = np.array([row["family"] == family for row in rows])
            if own.any():
                lines.append(
                    f"    {family:13} {gmean(ratio[own]):.3f}, worst {ratio[own].max():.2f} ({own.sum()} readings)"
                )
    for key in ("known", "unknown"):
        for row, ratio in zip(rows, ratios[key], strict=True):
            if ratio.max() > HARM:
                lines.append(f"  {key}, above {HARM}: {row['name']}, camera {row['camera']}: {ratio.round(2).tolist()}")
    refused = {key: np.array([row[f"{key}_refused"] for row in rows]) for key in ("known", "unknown")}
    lines += [f"  {key}: {own.mean():.1%} refused" for key, own in refused.items()]
    lost = gmean([row["unknown_sure"] for row in rows])
    lines.append(f"  not knowing the camera makes the standard deviation {lost:.2f} times as large (geometric mean)")
    return lines


def _kinds(key: str, own: dict[str, Any]) -> list[str]:
    some = ", ".join(f"{name}: {count}" for name, count in own["refused_of_camera"].items() if count)
    return [
        f"{key}: {own['lamps']} lamps, {own['readings']} readings, {own['refused']} refused, chi² ≤ {own['largest_chi2']:.2f} (limit {MOST_CHI2}), "
        f"expected calibration error {own['ece']:.3f}, log loss {own['log_loss']:.3f}",
        f"  refused of each camera, of {own['lamps']}: {some or 'none'}",
        *(f"  {name:13} {share:.1%} of {count}" for name, (share, count) in own["right"].items()),
        *(f"  said {said:.3f}, right {right:.3f} ({count})" for said, right, count in own["reliability"]),
    ]


def _held_out(own: dict[str, Any]) -> list[str]:
    lines = [f"temper and weight of LEDs chosen on either half of the lamps: {own['chosen']}"]
    for key in ("held_out", "shipped"):
        judged = own[key]
        right = ", ".join(f"{name} {share:.1%} of {count}" for name, (share, count) in judged["right"].items())
        lines.append(
            f"  {key}: {right}; expected calibration error {judged['ece']:.3f}, log loss {judged['log_loss']:.3f}"
        )
    return lines
