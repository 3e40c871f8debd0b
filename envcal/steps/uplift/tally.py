"""Counts of pixels by status and the round trip back to RGB, gathered tile by tile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal.maps import NAMED, places_told
from envcal.runner import Outcome
from envcal.steps.uplift.methods import Method, Solution

if TYPE_CHECKING:
    from uplift.pixels import Status
    from uplift.spectrum import RGBSpace

Image = npt.NDArray[np.float32]


#: ΔE2000 from which a pixel that came back otherwise than it went in is worth a word.
VISIBLE = 0.1
#: A smaller part of the sphere is not told in figures.
_LEAST_PERCENT = 0.001


class _Differences:
    """The mean and the largest of colour differences that come in parts."""

    def __init__(self) -> None:
        self.count = self.nan = self.visible = 0
        self.sum = self.largest = 0.0

    def add(self, values: npt.NDArray[np.float64]) -> None:
        kept = values[~np.isnan(values)]
        self.nan += values.size - kept.size
        self.count += values.size
        self.visible += int((kept > VISIBLE).sum())
        if kept.size:
            self.sum, self.largest = self.sum + float(kept.sum()), max(self.largest, float(kept.max()))

    def figures(self) -> dict[str, float]:
        return {"mean": self.sum / max(1, self.count - self.nan), "max": self.largest}


class Tally:
    """What became of the pixels of a map of `height` rows.

    `photographed`: its lost pixels were clipped; `reported`: a report is made, and shows where they are.
    """

    def __init__(
        self, method: Method, space: RGBSpace, height: int, *, photographed: bool = False, reported: bool = False
    ) -> None:
        from uplift.pixels import Status

        self._method, self._space, self._height = method, space, height
        self._counts = dict.fromkeys(Status, 0)
        self._weights = dict.fromkeys(Status, 0.0)
        self._differences = {kind: _Differences() for kind in (Status.EXACT, Status.FALLBACK, Status.CLOSEST)}
        self._stored = _Differences()
        self._darkened = self._visited = self._row = self._negative = 0
        self._photographed, self._reported = photographed, reported
        self._first: dict[Status, list[tuple[int, int]]] = {Status.CLOSEST: [], Status.MISSING: []}

    def add(self, rgb: Image, solved: Solution) -> None:
        """Take the next tile from the top into account."""
        from uplift.difference import delta_e_2000
        from uplift.pixels import Status

        found = solved.found
        rows = self._row + np.arange(len(rgb))
        for status, places in self._first.items():
            if found.counts[status] and len(places) < NAMED:
                more = np.argwhere(found.status == status)[: NAMED - len(places)]
                places += [(self._row + int(row), int(column)) for row, column in more]
        self._row += len(rgb)
        solid_angle = np.sin(np.pi * (rows + 0.5) / self._height)
        for status, count in found.counts.items():
            self._counts[status] += count
            if count:
                self._weights[status] += float((found.status == status).sum(axis=1) @ solid_angle)
        self._visited += solved.visited
        self._darkened += int(((found.status == Status.CLOSEST) & (found.scale == 0)).sum())
        for status, differences in self._differences.items():
            if not found.counts[status]:
                continue
            chosen = found.status == status
            asked = rgb[chosen].astype(np.float64)
            if status == Status.CLOSEST:
                self._negative += int((asked < 0).any(axis=-1).sum())
            differences.add(delta_e_2000(asked, solved.rgb(chosen, stored=False), self._space))
            if status != Status.CLOSEST:
                self._stored.add(delta_e_2000(asked, solved.rgb(chosen, stored=True), self._space))

    def outcome(self) -> Outcome:
        """The figures of the whole map."""
        from uplift.pixels import Status

        kept = _Differences()
        for status in (Status.EXACT, Status.FALLBACK):
            part = self._differences[status]
            kept.count, kept.nan, kept.sum = kept.count + part.count, kept.nan + part.nan, kept.sum + part.sum
            kept.largest = max(kept.largest, part.largest)
        pixels, sphere = sum(self._counts.values()), sum(self._weights.values())
        figures: dict[str, Any] = {
            "pixels": pixels,
            "status": _named(self._counts),
            "solid_angle": _named({status: weight / sphere for status, weight in self._weights.items()}),
            "round_trip_delta_e": kept.figures(),
            "round_trip_delta_e_stored": self._stored.figures(),
            "round_trip_nan": kept.nan + self._stored.nan,
            "delta_e_by_status": _named({status: part.figures() for status, part in self._differences.items()}),
            "largest_shift_delta_e": self._differences[Status.CLOSEST].largest,
            "darkened": self._darkened,
        }
        if self._visited:
            figures["cells_visited"] = self._visited / max(1, pixels)
        summary = f"round trip ΔE2000 at most {kept.largest:.1e} ({self._stored.figures()['max']:.1e} as stored)"
        others = [f"{count} {status.name.lower()}" for status, count in self._counts.items() if count and status]
        return Outcome("; ".join([summary, *others]), figures, self._warnings(pixels, sphere))

    def _warnings(self, pixels: int, sphere: float) -> list[str]:
        from uplift.pixels import Status

        def of(status: Status) -> str:
            count, places = self._counts[status], self._first.get(status, [])
            where = places_told(places, count) if places else ""
            if count == 1:
                return f"1 pixel ({where})" if where else "1 pixel"
            share = 100 * self._weights[status] / sphere
            told = f"{share:.2g}" if share >= _LEAST_PERCENT else f"under {_LEAST_PERCENT:g}"
            return f"{count} of {pixels} pixels ({told} % of the sphere{f'; {where}' if where else ''})"

        warnings = []
        if self._counts[Status.FALLBACK]:
            warnings.append(f"{of(Status.FALLBACK)}: {self._method.fallback}.")
        if self._counts[Status.CLOSEST]:
            warnings.append(f"{of(Status.CLOSEST)}: {self._method.closest}; {self._moved()}. {self._method.advice}")
            if self._reported:
                warnings[-1] += " The report shows where they are."
        if self._stored.visible:
            warnings.append(
                f"{self._stored.visible} of {pixels} pixels of very pure colours lose some of it in the file's 32 bits: up to "
                f"ΔE2000 {self._stored.largest:.2g}."
            )
        if self._counts[Status.MISSING]:
            why, remedy = "NaN or infinite in the file", "Repaint the map there, or write it again"
            if self._photographed:
                why, remedy = "missing (clipped in every frame)", "Add a shorter exposure to the bracket"
            warnings.append(f"{of(Status.MISSING)}: {why}, without radiance: black holes in the light. {remedy}.")
        return warnings

    def _moved(self) -> str:
        """How far the colours that no light can show were moved, and how many were not even colours."""
        from uplift.pixels import Status

        shift, count = self._differences[Status.CLOSEST].figures(), self._counts[Status.CLOSEST]
        if count == 1:
            told = f"moved by ΔE2000 {shift['max']:.3g}"
            told += ", from a negative component" if self._negative else ""
            return told + (", and black now, as its luminance was negative" if self._darkened else "")
        told = f"moved by ΔE2000 {shift['mean']:.3g} on average and up to {shift['max']:.3g}"
        told += f"; {self._negative} of them have negative components" if self._negative else ""
        return told + (f", and {self._darkened} of them, of negative luminance, became black" if self._darkened else "")


def _named(by_status: Mapping[Status, Any]) -> dict[str, Any]:
    return {status.name.lower(): value for status, value in by_status.items()}
