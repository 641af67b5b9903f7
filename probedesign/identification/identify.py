"""Identification of a probe: a campaign and a design in; numbers with intervals and design changes out."""

import json
import math
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.campaigns import Campaign, Test
from probedesign.campaigns.campaign import TESTS
from probedesign.campaigns.checks import check_probe
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MPA
from probedesign.design import Design
from probedesign.design.io import Change
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import ASSUMED_STIFFNESS, IDENTIFIED, Tolerances
from probedesign.identification import result
from probedesign.identification.fit_checks import (
    UnobservableDirection,
    inconsistency,
    outlier_notes,
    rejected_prior,
    unobservable_direction,
)
from probedesign.identification.parameters import (
    DEFAULT,
    LOG_E,
    PARAMETERS,
    CommonParameters,
    check_requested,
    columns_of,
)
from probedesign.identification.residuals import MassMeasurement, MeasuredTest
from probedesign.identification.result import Identification, Identified, Outlier
from probedesign.identification.solver import (
    Fit,
    LeastSquaresProblem,
    fit,
    outliers,
    solvable_tests,
    start_point,
    weights,
)

MIN_READINGS = 8
"""Readings of one test from which on their scatter replaces the sensor's noise where it is larger."""
SUSPICIOUS_FACTOR = 3.0
"""Factor on the design's E from which on units are questioned: published values of one resin, 1.6 to 3.2 MPa, differ by
two, and a factor on all forces cannot be distinguished from a factor on E."""
START_TOLERANCE = 3.0
"""Factor on the limits of observability at the start of the search, where the parameters are rough."""
IN_DESIGN = {name: one for name, one in PARAMETERS.items() if one.design_key}
"""Parameters that a design file holds."""
MATERIAL = {name: one for name, one in IN_DESIGN.items() if one.design_key.startswith("material.")}
REPLACED_WITH_E = ("material.stiffness_spread", "tolerances.youngs_modulus_by_diameter")
"""Keys that an identification of E replaces as well, where E was not identified before."""


@dataclass(frozen=True)
class IdentificationData:
    """Tests of one probe as the fit uses them.

    Attributes:
        common: parameters that the tests share.
        tests: usable tests.
        mass: the weighing; None if there was none.
        where: names the data in messages.
        notes: lines for the user.
    """

    common: CommonParameters
    tests: tuple[MeasuredTest, ...]
    mass: MassMeasurement | None
    where: str
    notes: tuple[str, ...] = ()


def data_of(campaign: Campaign, model: ProbeModel, flange_volume: float) -> IdentificationData:
    """Return a campaign's data for `identify`.

    Args:
        campaign: from `read_campaign`.
        model: of the probe as designed.
        flange_volume: of the printed flange below the base [m³].

    Raises:
        InputError: it is of another probe.
    """
    check_probe(campaign, model)
    common = CommonParameters(model, Tolerances.of(model), campaign.std_base, campaign.std_tilt)
    tests, notes = [], list(campaign.notes)
    held_out = sum(test.use == "validate" for test in campaign.tests)
    if held_out:
        notes.append(f"held out for validate by use in {TESTS}: {held_out} of {len(campaign.tests)} tests")
    for test in campaign.tests:
        if test.use == "validate":
            continue
        measured = _measured(test, campaign, common)
        why = _unusable(measured)
        if why:
            notes.append(f"{test.name}: not used: {why}")
        else:
            tests.append(measured)
    weighing = campaign.weighing
    mass = None
    if weighing is not None:
        flange = flange_volume if weighing.of == "probe" else 0.0
        mass = MassMeasurement(weighing.mass, weighing.std, flange)
    return IdentificationData(common, tuple(tests), mass, str(campaign.folder), tuple(notes))


def _measured(test: Test, campaign: Campaign, common: CommonParameters) -> MeasuredTest:
    measured = MeasuredTest(
        test.name, test.T_world_base, test.gravity_world, test.force_world, test.s_contact,
        0.0 if np.isnan(test.std_s) else test.std_s, test.p_contact_world, test.std_contact,
        sag=test.tip_sag, std_sag=test.std_sag,
    )  # fmt: skip
    if len(test.wrenches):
        wrench, cov = _mean_reading(test, common)
        measured = replace(measured, wrench_base=wrench, cov_wrench=cov)
    if test.markers is None or not len(test.markers):
        return measured
    markers = test.markers
    return replace(
        measured, marker_s=campaign.marker_s[markers.numbers], p_markers_world=markers.p_world,
        cov_markers=markers.cov_world, marker_numbers=tuple(int(i) + 1 for i in markers.numbers),
        marker_side=campaign.marker_side,
    )  # fmt: skip


def _mean_reading(test: Test, common: CommonParameters) -> tuple[Array, Array]:
    """Return the mean of a test's readings at the base, and its covariance with the drift of the bias."""
    model, n = common.model, len(test.wrenches)
    noise = model.noise_base()
    if n >= MIN_READINGS:
        scatter = np.var(test.wrenches_base(model), axis=0, ddof=1)
        ratio = np.sqrt(np.maximum(scatter / np.diag(noise), 1.0))
        noise = noise * np.outer(ratio, ratio)
    return test.mean_wrench_base(model), noise / n + common.drift_cov


def _unusable(test: MeasuredTest) -> str:
    """Return why a test cannot be used; empty if it can."""
    placed = np.isfinite(test.s_contact) or test.p_touch_world is not None
    if test.touched and test.wrench_base is None:
        return "it has neither a known force nor a wrench"
    if not test.free and not placed and not len(test.marker_s):
        return "it has neither the place of the load nor markers"
    if not test.touched and not placed and not test.free and test.wrench_base is None:
        return "the place of the known force is missing"
    measured = test.wrench_base is not None or len(test.marker_s) or np.isfinite(test.sag)
    if not measured and (test.free or test.p_touch_world is None):
        return "it has no measured value"
    return ""


def identify(data: IdentificationData, names: Sequence[str] = DEFAULT) -> Identification:
    """Identify parameters by robust least squares on the full rod.

    Args:
        data: from `data_of`.
        names: requested parameters, of `parameters.REQUESTABLE`; one that is not observable stays at the design value.

    Raises:
        InputError: an unknown name, too few tests, or tests in which no requested parameter is observable.
    """
    begun = time.perf_counter()
    names = check_requested(names)
    data = _without_unsolvable(data, names)
    _check_counts(data, names)
    found, identified, unobservable = _search(data, names)
    quantile = result.student_quantile(found)
    numbers, correlation, correlated = result.identified_numbers(
        found, identified, unobservable, names, quantile
    )
    effects = result.systematic_effects(found, identified)
    numbers = result.with_caveats(result.with_systematics(numbers, effects, quantile), data.common.model.rod)
    problem, blocks = found.point.problem, found.point.blocks
    off = outliers(blocks, found.scales)
    whole = Identification(
        found.result, data.common.model.name, data.common.model.fingerprint, data.where, len(data.tests),
        sum(len(block.r) for block in blocks), problem.size, numbers, correlation, correlated,
        found.noise, quantile,
        tuple(Outlier(block.test, block.kind, block.item, distance) for block, distance in off), effects,
        (*data.notes, *(one.description for one in unobservable), *outlier_notes(blocks, off), *_remarks(found)),
        result.residuals_of(found), time.perf_counter() - begun,
    )  # fmt: skip
    why = inconsistency(blocks, off, found.noise) or rejected_prior(found)
    return whole.as_inconsistent(why) if why else whole


def _search(
    data: IdentificationData, names: Sequence[str]
) -> tuple[Fit, tuple[str, ...], list[UnobservableDirection]]:
    """Fit the observable parameters of `names`; fix the others at the design, one after the other."""
    requested, unobservable = tuple(names), list[UnobservableDirection]()
    while requested:
        prior = data.common.prior_without(requested)
        problem = LeastSquaresProblem(data.common, data.tests, data.mass, prior)
        start = start_point(problem, "E" in requested)
        assert start is not None  # by `_without_unsolvable`, test by test
        lost = unobservable_direction(start, weights(start.blocks, {}), requested, START_TOLERANCE)
        if lost is None:
            found = fit(problem, start)
            lost = unobservable_direction(found.point, found.weight, requested)
            if lost is None:
                return found, requested, unobservable
        unobservable.append(lost)
        requested = tuple(name for name in requested if name != lost.name)
    raise InputError(
        f"{data.where}: too few tests, or too weak ones: {'; '.join(one.description for one in unobservable)}"
    )


def _without_unsolvable(data: IdentificationData, names: Sequence[str]) -> IdentificationData:
    """Return the data without the tests in which the rod has no stable equilibrium, with a note for each."""
    if not data.tests:
        first = f": {data.notes[0]}" if data.notes else ""
        raise InputError(f"{data.where}: no test can be used{first}")
    problem = LeastSquaresProblem(data.common, data.tests, data.mass, data.common.prior_without(names))
    free_E = "E" in names
    if start_point(problem, free_E) is not None:
        return data
    kept, lost = solvable_tests(problem, free_E)
    if not kept or start_point(replace(problem, tests=tuple(kept)), free_E) is None:
        raise InputError(
            f"{data.where}: the probe buckles in its tests for any E; is it the right design, and are forces in "
            "their column's unit?"
        )
    notes = tuple(f"{one.name}: not used: the probe buckles under its load" for one in lost)
    return replace(data, tests=tuple(kept), notes=(*data.notes, *notes))


def _check_counts(data: IdentificationData, names: Sequence[str]) -> None:
    """Refuse fewer measured values than unknowns."""
    values = sum(
        6 * (one.wrench_base is not None) + 3 * len(one.marker_s) + 3 * (one.p_touch_world is not None)
        + bool(one.sag == one.sag) + (one.s_estimated and one.s_contact == one.s_contact) + one.touched
        for one in data.tests
    ) + (data.mass is not None)  # fmt: skip
    unknowns = len(columns_of(names)) + sum(one.nuisance_size for one in data.tests)
    if values < unknowns:
        raise InputError(
            f"{data.where}: too few tests for {', '.join(names)}: {values} values are measured for {unknowns} unknowns"
        )


def _remarks(found: Fit) -> list[str]:
    """Return notes on the fit for the user."""
    notes = []
    factor = math.exp(found.point.values.x[LOG_E])
    if not 1.0 / SUSPICIOUS_FACTOR < factor < SUSPICIOUS_FACTOR:
        notes.append(f"E is {factor:.3g} times the design's: are forces and moments in their columns' units?")
    return notes + [
        f"{one.kind} scatter {one.scale:.2g} times as much as stated; the intervals include it"
        for one in found.noise
        if one.measured
    ]


# changes of the design


def design_changes(found: Identification, design: Design, day: str) -> tuple[Change, ...]:
    """Return the keys that a design gets; poses and gravity belong to the bench and not to the probe.

    The value written is conditional on the design's diameters, which the frozen probe uses too: of E and diameters it
    is E·d⁴ that was measured, and `youngs_modulus_by_diameter` states it. The standard deviations written include
    the systematic effects. `day` is for the comments.

    Raises:
        InputError: no number of a design was identified, or the fit is not valid.
    """
    if found.result != "ok":
        why = found.why or "the search did not converge"
        raise InputError(f"{found.data}: {found.result}: {why}; nothing is written")
    numbers = [one for one in found.found if one.identified and one.name in IN_DESIGN]
    if not numbers:
        raise InputError(
            f"{found.data}: no number of a design is identified; use --for {', '.join(IN_DESIGN)}"
        )
    changes = [_value(one, found, day) for one in numbers]
    material = [one for one in numbers if one.name in MATERIAL]
    changes += [Change("material.provenance", _split_key(one.name)[1], '"identified"') for one in material]
    for one in material:
        assert one.std is not None
        note = f"identified {day}: {one.std / one.value:.2g} by the fit"
        if one.std != one.std_total:
            note += ", the rest systematic effects, each as one standard deviation"
        key, value = PARAMETERS[one.name].attribute, f"{one.relative_std_total:.2g}"
        changes.append(Change("tolerances", key, value, note))
    changes += _served(found, design, [_split_key(one.name)[1] for one in material], day)
    E = found.of("E")
    if E is None:
        return tuple(changes)
    changes.append(Change("material", "stiffness_spread", f"{E.relative_std_total:.2g}",
                          f"identified {day}: of E, as in [tolerances], for fusing touches"))  # fmt: skip
    if E.by_diameter is not None:
        changes.append(Change("tolerances", "youngs_modulus_by_diameter", f"{E.by_diameter:.2f}",
                              f"identified {day}: E·d⁴ was measured, so E goes with the diameters"))  # fmt: skip
    if found.of("G") is None and design.tolerances.shear_modulus is None:
        # the tolerance of G follows stiffness_spread unless it is set
        spread = design.material.stiffness_spread
        usual = IDENTIFIED if design.youngs_modulus.provenance == "identified" else ASSUMED_STIFFNESS
        changes.append(Change("tolerances", "shear_modulus", f"{usual if spread is None else spread:.2g}",
                              "as before: the tests did not determine it"))  # fmt: skip
    return tuple(changes)


def _served(found: Identification, design: Design, keys: Sequence[str], day: str) -> list[Change]:
    """Return the change of the list of tests that served; those of values which stay identified are kept."""
    if not found.served or not keys:
        return []
    provenance = design.material.provenance.model_dump()
    stay = any(provenance[key] == "identified" for key in provenance if key not in keys)
    served = dict.fromkeys((*(design.material.identified_tests if stay else ()), *found.served))
    note = f"identified {day}: fingerprints of the tests that served; validate leaves them out"
    return [Change("material", "identified_tests", json.dumps(list(served)), note)]


def _split_key(name: str) -> tuple[str, str]:
    table, key = PARAMETERS[name].design_key.split(".")
    return table, key


def _value(one: Identified, found: Identification, day: str) -> Change:
    caveat = f"; {one.caveat}" if one.caveat else ""
    tests = f"{found.tests} test{'s' * (found.tests != 1)}"
    note = (f"identified {day}, {tests}: {one.low_total:.4g} ... {one.high_total:.4g} in 95 %, with these "
            f"diameters{caveat}")  # fmt: skip
    return Change(*_split_key(one.name), f"{one.value:.4g}", note)


def check_overwritable(
    design: Design, text: str, changes: tuple[Change, ...], where: str, force: bool
) -> None:
    """Refuse to replace what someone set or identified before in a file's text, unless `force` is set.

    A material's value that is not identified yet is what an identification is for, and its uncertainty goes with it.
    """
    document = tomllib.loads(text)
    present = [f"{one.table}.{one.key}" for one in changes
               if not _replaceable(one, design)
               and _value_in(document, one) not in (None, tomllib.loads(f"v = {one.text}")["v"])]  # fmt: skip
    if present and not force:
        raise InputError(f"{where}: set or identified already: {', '.join(present)}; --force replaces these values "
                         "and keeps them as comments, or write another file with --out")  # fmt: skip


def _replaceable(change: Change, design: Design) -> bool:
    """Return whether the change is a provenance, or of a value that is not identified yet or of its uncertainty."""
    key = f"{change.table}.{change.key}"
    if change.table == "material.provenance" or key == "material.identified_tests":
        return True
    for name, one in MATERIAL.items():
        if key in (one.design_key, f"tolerances.{one.attribute}", *(REPLACED_WITH_E if name == "E" else ())):
            provenance: str = getattr(design.material.provenance, _split_key(name)[1])
            return provenance != "identified"
    return False


def _value_in(document: dict[str, Any], change: Change) -> object:
    """Return the value in a design file; None if there is none."""
    value: Any = document
    for part in (*change.table.split("."), change.key):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def design_diff(design: Design, fingerprint: str, file: Path) -> str:
    """Return which numbers of an earlier identification, in `file`, a design of this geometry lacks; empty if none."""
    try:
        data = json.loads(file.read_bytes())
        if data["result"] != "ok" or data["fingerprint"] != fingerprint:
            return ""
        differences = []
        for one in data["found"]:
            if one["result"] == "identified" and one["name"] in MATERIAL:
                quantity = getattr(design, MATERIAL[one["name"]].attribute)
                unit = MPA if one["unit"] == "MPa" else 1.0
                # a design gets four digits
                identified, present = f"{one['value']:.4g}", f"{quantity.value / unit:.4g}"
                if identified != present:
                    text = f"{one['name']} {identified} {one['unit']}, where the design has {present}"
                    differences.append(text)
        return f"by {data['tests']} tests of {data['data']}, {', '.join(differences)}" if differences else ""
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
    ):  # no identification was made, or another program's file
        return ""
