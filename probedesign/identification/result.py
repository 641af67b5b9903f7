"""What an identification found."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from probedesign.frames import Array
from probedesign.identification.robust import Noise

CONFIDENCE = 0.95
UNITS = {"markers": "mm", "touches": "mm", "places": "mm", "sags": "mm", "wrenches": "N and N·m", "scales": "g",
         "friction": "share of the force"}  # fmt: skip
"""Of residuals."""


@dataclass(frozen=True)
class Identified:
    """One number that was asked for.

    Attributes:
        name: as it was asked for, or its part: E, tilt_x.
        words: what it is.
        unit: of all that follow; empty for plain factors.
        result: "identified", or "not_told": then `value` is the design's and nothing else is said.
        value: with the design's diameters taken as they are, as the frozen probe takes them, even where those are asked
            for as well.
        std: of it.
        low, high: 95 % of it.
        design: the design's value; 0 for a pose.
        value_of_print, std_of_print, low_of_print, high_of_print: the same where the diameters are known as well as
            the design's tolerances have them: of the material rather than of the probe.
        std_in_all, low_in_all, high_in_all: of `value` with what `std` does not count: each of the shifts that the
            identification lists of it taken for one standard deviation, independent of the others. A design gets these.
        by_diameter: power of the base diameter with which `value` goes, where all diameters are other than designed
            together; None where that was not asked of the tests.
        doubt: what must be said beside the number; empty if nothing.
        why: what the tests tell instead, where it is not told.
    """

    name: str
    words: str
    unit: str
    result: Literal["identified", "not_told"]
    value: float
    design: float
    std: float | None = None
    low: float | None = None
    high: float | None = None
    value_of_print: float | None = None
    std_of_print: float | None = None
    low_of_print: float | None = None
    high_of_print: float | None = None
    std_in_all: float | None = None
    low_in_all: float | None = None
    high_in_all: float | None = None
    by_diameter: float | None = None
    doubt: str = ""
    why: str = ""

    @property
    def share_in_all(self) -> float:
        """`std_in_all` as a share of the value."""
        assert self.std_in_all is not None
        return self.std_in_all / self.value

    @property
    def identified(self) -> bool:
        """Whether the tests told it."""
        return self.result == "identified"


@dataclass(frozen=True)
class Outlier:
    """A reading that noise does not explain; it hardly counted.

    Attributes:
        test: its test.
        kind: markers, wrenches or touches.
        item: the marker's number; 0 of others.
        deviations: how far off, in standard deviations.
    """

    test: str
    kind: str
    item: int
    deviations: float

    @property
    def words(self) -> str:
        """What it is."""
        what = {"markers": f"marker {self.item}", "wrenches": "the wrench", "touches": "the place touched"}
        return f"{what[self.kind]} of {self.test}"


@dataclass(frozen=True)
class Shift:
    """What would change one number, and is not counted in its interval.

    Attributes:
        cause: in words.
        of: the number.
        percent: by which it would change.
    """

    cause: str
    of: str
    percent: float


@dataclass(frozen=True)
class Residual:
    """One reading against the fit.

    Attributes:
        test, kind, item: which.
        s_mm: arclength, of a marker or a touch; None of others.
        off: told less expected: mm, or N and N·m, or g.
        deviations: distance in standard deviations as used, over the root of how many numbers it has.
        weight: 1 of a reading that is trusted.
    """

    test: str
    kind: str
    item: int
    s_mm: float | None
    off: tuple[float, ...]
    deviations: float
    weight: float


@dataclass(frozen=True)
class Identification:
    """The numbers of one campaign.

    Attributes:
        result: "ok"; "not_converged"; or "inconsistent": the tests contradict the probe as designed, or each other.
        name: of the design.
        fingerprint: of its geometry.
        data: folder of the campaign.
        tests: how many were used.
        numbers: how many readings' numbers, against how many unknowns.
        unknowns: see `numbers`.
        found: what was asked for.
        correlation: of what was identified, in the order of `correlated`, with the design's diameters.
        correlated: their names.
        noise: of each kind of reading.
        quantile: of the 95 % intervals, in standard deviations: Student's where noise was measured.
        outliers: named.
        shifts: what is not counted.
        notes: lines for the user.
        residuals: every reading.
        seconds: that it took.
        why: what contradicts and where to look, where the result is "inconsistent".
    """

    result: str
    name: str
    fingerprint: str
    data: str
    tests: int
    numbers: int
    unknowns: int
    found: tuple[Identified, ...]
    correlation: Array
    correlated: tuple[str, ...]
    noise: tuple[Noise, ...]
    quantile: float
    outliers: tuple[Outlier, ...]
    shifts: tuple[Shift, ...]
    notes: tuple[str, ...]
    residuals: tuple[Residual, ...]
    seconds: float
    why: str = ""

    def contradicted(self, why: str) -> "Identification":
        """The same with nothing claimed: no number, no interval, no shift.

        Args:
            why: in words.
        """
        found = tuple(
            Identified(one.name, one.words, one.unit, "not_told", one.design, one.design,
                       why=one.why or "the tests contradict the design, or each other")
            for one in self.found
        )  # fmt: skip
        return replace(self, result="inconsistent", found=found, correlation=np.empty((0, 0)), correlated=(),
                       shifts=(), why=why)  # fmt: skip

    @property
    def dimensions(self) -> str:
        """What the second interval of each number is with."""
        return "tolerances of dimensions" if self.of("diameters") is None else "the diameters found"

    @property
    def doubts(self) -> tuple[str, ...]:
        """What must be said beside the numbers, a line for each that has any."""
        return tuple(f"{one.name}: {one.doubt}" for one in self.found if one.doubt)

    @property
    def causes(self) -> dict[str, tuple[Shift, ...]]:
        """The shifts by their cause."""
        causes = dict.fromkeys(shift.cause for shift in self.shifts)
        return {cause: tuple(shift for shift in self.shifts if shift.cause == cause) for cause in causes}

    def of(self, name: str) -> Identified | None:
        """The number of that name, if it was asked for and told."""
        return next((one for one in self.found if one.name == name and one.identified), None)

    def csv(self) -> bytes:
        """Every reading against the fit, a row each."""
        rows = ["test,kind,item,s_mm,off_1,off_2,off_3,off_4,off_5,off_6,unit,deviations,weight"]
        for one in self.residuals:
            off = [f"{value:.6g}" for value in one.off] + [""] * (6 - len(one.off))
            s = "" if one.s_mm is None else f"{one.s_mm:.6g}"
            unit = UNITS[one.kind]
            cells = [
                one.test,
                one.kind,
                str(one.item or ""),
                s,
                *off,
                unit,
                f"{one.deviations:.4g}",
                f"{one.weight:.4g}",
            ]
            rows.append(",".join(cells))
        return ("\n".join(rows) + "\n").encode()

    def as_dict(self) -> dict[str, Any]:
        """Plain, for JSON."""
        document = asdict(self)
        document["correlation"] = self.correlation.tolist()
        document["residuals"] = [{**row, "unit": UNITS[row["kind"]]} for row in document["residuals"]]
        return document
