"""The figures of `benchmarks.lights` as text, each with what is asked of it."""

from __future__ import annotations

from typing import Any

import numpy as np

SINGLE_K = (1900.0, 6600.0)


def gmean(values: Any) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(np.asarray(values, np.float64)))))


def report(figures: dict[str, Any]) -> str:
    """Return the figures as text, each with what is asked of it."""
    lines = []
    t = figures["times"]
    lines.append(
        f"time at {figures['size'][0]}×{figures['size'][1]}: sky {t['sky_s']:.3f} s, clusters {t['clusters_s']:.3f} s, "
        f"CCT and spectra {t['lights_s']:.3f} s, all {t['all_s']:.3f} s ({t['all_cpu_s']:.2f} s of CPU); "
        f"ratio to 1 s: {t['all_s']:.2f}"
    )
    if "single" in figures:
        lines += _single_report(figures["single"]["rows"])
    if "several" in figures:
        lines += _several_report(figures["several"]["rows"])
    if "shared" in figures:
        lines += _shared_report(figures["shared"])
    if "outdoors" in figures:
        for row in figures["outdoors"]["rows"]:
            lines.append(
                f"{row['scene']}: sky {row['sky']}, {row['clusters']} clusters ({row['outdoor']} outdoor), {row['cct']:.0f} K: "
                f"ΔE {row['chosen']:.3f}, best single CCT {row['best_cct']:.0f} K {row['best']:.3f}, ratio "
                f"{row['chosen'] / row['best']:.3f} (≤ 1.10); ÷ scaled {row['chosen'] / row['scaled']:.2f}"
            )
    return "\n".join(lines)


def _single_report(rows: list[dict[str, Any]]) -> list[str]:
    lamps_of_figure = [
        row
        for row in rows
        if row["kind"] in ("led", "fluorescent", "incandescent") and SINGLE_K[0] <= row["cct"] <= SINGLE_K[1]
    ]
    off = np.array([abs(row["cct_seen"] / row["cct"] - 1) for row in lamps_of_figure])
    one = [row["clusters"] == 1 for row in lamps_of_figure]
    lines = [
        f"one lamp ({len(rows)} maps; {len(off)} of LED, fluorescent, incandescent 1900–6600 K): one cluster in "
        f"{np.mean(one):.1%}; CCT off by {np.median(off):.2%} median (≤ 3 %), {off.max():.2%} worst (≤ 6 %); "
        f"sky seen in {sum(row['sky'] for row in rows)} of {len(rows)} rooms"
    ]
    within = [abs(row["cct_seen"] - row["cct"]) <= row["cct_sigma"] for row in rows if np.isfinite(row["cct_seen"])]
    lines.append(f"  the CCT is within its stated standard deviation in {np.mean(within):.0%} of the maps")
    for kind, asked in (("led", 0.45), ("fluorescent", 0.25), ("incandescent", 0.5)):
        for own in (True, False):
            those = [row for row in rows if row["kind"] == kind and row["library"] == own]
            if kind == "incandescent":
                those = [row for row in those if row["cct"] < 2200 - 1]
            if those:
                called = f"declared {kind}{' below 2200 K' if kind == 'incandescent' else ''}"
                lines.append(
                    f"  {called}, {'in the library' if own else 'others'} ({len(those)} maps): ratio {_ratios(those, 'declared')}"
                    f"{f' (≤ {asked})' if own else ''}; floor, with the true spectrum: {_ratios(those, 'true')}"
                )
    for key in ("undeclared", "smooth", "led", "fluorescent", "blend", "true"):
        known = [row for row in rows if key in row]
        if known:
            worst = max(known, key=lambda row: row[key])
            lines.append(
                f"  {key}: ratio {gmean([row[key] for row in known]):.3f} geometric mean, worst {worst[key]:.2f} "
                f"({worst['scene']}), {sum(row[key] > 1.15 for row in known)} of {len(known)} above 1.15"
                + (" (asked: ≤ 0.95, none)" if key == "undeclared" else "")
            )
    return lines


def _several_report(rows: list[dict[str, Any]]) -> list[str]:
    found = [one for row in rows for one in row["found"]]
    right = np.array([row["right"] for row in rows])
    return [
        f"several lamps ({len(rows)} maps): {np.mean(found):.1%} of the lamps with 10 % of the light found within 8 % CCT "
        f"(asked: all); pixels in the right cluster, by luminance: {np.median(right):.1%} median (≥ 85 %), {right.min():.1%} worst, "
        f"{np.percentile(right, 10):.1%} tenth percentile; {sum(row['spurious'] for row in rows)} clusters of no lamp; "
        f"sky seen in {sum(row['sky'] for row in rows)}"
    ]


def _ratios(rows: list[dict[str, Any]], key: str) -> str:
    """Mean of the ratios to the scaled uplift, ratio of the mean errors, and the greatest ratio."""
    ratios = np.array([row[key] for row in rows])
    scaled = np.array([row["scaled"] for row in rows])
    return f"{ratios.mean():.3f}, of the mean errors {(ratios * scaled).sum() / scaled.sum():.3f}, worst {ratios.max():.2f}"


def _shared_report(figures: dict[str, Any]) -> list[str]:
    rows = figures["rows"]
    if not rows:
        return [f"two declared lamps: none of {figures['left_out']} rooms had both found"]
    told = ", ".join(
        f"{key} {gmean([row[key] for row in rows]):.3f}" for key in rows[0] if key not in ("scene", "scaled")
    )
    better = sum(row["mixed"] < row["one"] for row in rows)
    return [
        f"two lamps of known spectra ({len(rows)} maps, {figures['left_out']} left out as not both were found), ratio, geometric "
        f"mean, of pixels with one light or a mixture of both in quarters: {told}; mixed is better in {better}"
    ]
