"""Whether the markers of a test can stand on one probe: no two are farther apart than the probe between them."""

import numpy as np

from probedesign.campaigns.campaign import Markers
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.units import MM

DEVIATIONS = 5.0
"""So many standard deviations farther apart than the probe is long between them: one true pair in 3 million."""
STRETCH = 0.05
"""The probe may be longer than drawn: it stretches by a percent or two under its own weight, and markers are set
by hand (assumed)."""
SURFACE_STRETCH, SURFACE_OFF = 0.10, 6.0 * MM
"""On the surface a bent probe is longer than on its axis, and the base's centre is a radius away [m]: those of the
paper's large probe."""
SET = 1.0 * MM
"""Play in setting a marker [m]: assumed."""


def check_order(
    where: str, markers: Markers, marker_s: Array, marker_side: float | None, p_base: Array, std_base: float
) -> None:
    """Refuse markers that cannot be on a probe whose base stands where it is said to.

    Args:
        where: names the test in errors.
        markers: of it.
        marker_s: arclength of each of the campaign's [m].
        marker_side: as the campaign has it; on the surface a pair may be farther apart than along the axis.
        p_base: where the base is said to be [m], (3,).
        std_base: of that [m].

    Raises:
        InputError: two markers are too far apart, whose numbers are then in another order or their unit another.
    """
    s = np.concatenate([[0.0], marker_s[markers.numbers]])
    p = np.vstack([p_base, markers.p_world])
    variance = np.concatenate([[std_base**2], np.linalg.eigvalsh(markers.cov_world)[:, -1]])
    apart = np.linalg.norm(p[:, None] - p[None], axis=2)
    arc = np.abs(s[:, None] - s[None])
    stretch = STRETCH if marker_side is None else SURFACE_STRETCH
    slack = DEVIATIONS * np.sqrt(variance[:, None] + variance[None]) + stretch * arc + SET
    slack[0] += 0.0 if marker_side is None else SURFACE_OFF
    over = np.where(np.triu(np.ones_like(arc), 1) > 0, apart - arc - slack, -np.inf)
    _check_unit(where, s, p)
    if over.max() > 0.0:
        _check_reversed(where, s, apart, slack)
        _fail(where, markers, over, apart, arc)


def _check_unit(where: str, s: Array, p: Array) -> None:
    """Markers as a whole many times too far apart or too near each other are in another unit."""
    if len(s) < 3:
        return
    steps, on_probe = np.median(np.linalg.norm(np.diff(p[1:], axis=0), axis=1)), np.median(np.diff(s[1:]))
    if not 0.05 < steps / on_probe < 20.0:
        what = f"markers lie {steps / MM:.4g} mm apart, on the probe {on_probe / MM:.4g}"
        raise InputError(f"{where}: {what}; metres in a column of millimetres, or the other way round?")


def _check_reversed(where: str, s: Array, apart: Array, slack: Array) -> None:
    """Whether numbering them the other way round puts everything right."""
    turned = np.concatenate([[0], np.arange(len(s) - 1, 0, -1)])
    arc = np.abs(s[:, None] - s[None])
    if len(s) > 2 and (apart[np.ix_(turned, turned)] <= arc + slack).all():
        raise InputError(
            f"{where}: markers out of order: they count from the tip; marker 1 is nearest to the base"
        )


def _fail(where: str, markers: Markers, over: Array, apart: Array, arc: Array) -> None:
    i, j = np.unravel_index(int(np.argmax(over)), over.shape)
    other = f"marker {markers.numbers[j - 1] + 1}"
    one = "the base" if i == 0 else f"marker {markers.numbers[i - 1] + 1}"
    off = f"{apart[i, j] / MM:.4g} mm apart, on the probe {arc[i, j] / MM:.4g}"
    far = (over > 0)[0, 1:].all() if i == 0 else False
    why = "is the pose of the base right?" if far else "markers out of order, or one of them wrong"
    raise InputError(f"{where}: {one} and {other} lie {off}; {why}")
